"""A command that is ended while it writes, and what its output is afterwards. See tools.fuzz.interruptions."""

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from tests.messages import without_progress

ROOT = Path(__file__).parents[2]
COMMANDS = {"train": "train", "make": "make", "bake": "bake", "convert": "pack", "picture": "render", "film": "render"}
PATIENCE_S = 900.0
LIKE = 4.0  # grey levels: how far pictures of two films of the same pictures may be from each other, on average
STEPS = "60"


@dataclass
class Writer:
    """A command. words: of its line, but for what follows --out. older: puts an earlier output there, if it replaces one.

    voices: how many processes may say why they end.
    """

    voices: ClassVar[int] = 1
    name: str
    words: list[str]
    out: str
    older: Callable[[Path], object] | None = None
    expected: str = ""
    seconds: float = 0.0
    problems: list[str] = field(default_factory=list)

    def line(self, out: Path) -> list[str]:
        """Program and arguments that write `out`."""
        return [sys.executable, "-m", "snerg", COMMANDS[self.name], *self.words, "--out", str(out)]

    def start(self, out: Path, *more: str) -> subprocess.Popen[str]:
        words, none = [*self.line(out), *more], subprocess.DEVNULL
        return subprocess.Popen(
            words, cwd=ROOT, text=True, start_new_session=True, stdin=none, stdout=none, stderr=subprocess.PIPE
        )

    def end(self, child: subprocess.Popen[str]) -> None:
        """kill -9, and all that it started with it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)

    def run(self, out: Path) -> tuple[int, str]:
        """To its end: the exit status, and what it said on stderr."""
        begun = self.name == "train" and (out / "config.json").is_file()
        child = self.start(out, *(["--resume"] if begun else []))
        _, said = child.communicate(timeout=PATIENCE_S)
        return child.returncode, said

    def measure(self, place: Path) -> None:
        """What an undisturbed run leaves, twice, and how long the second one takes."""
        found = []
        for _ in range(2):
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
            began = time.monotonic()
            status, said = self.run(place / self.out)
            self.seconds = time.monotonic() - began
            if status:
                raise RuntimeError(f"{self.name} fails undisturbed: {said[-2000:]}")
            found.append(digest(place / self.out))
        if found[0] != found[1]:
            raise RuntimeError(f"{self.name} leaves something else each time; nothing can be compared")
        self.expected = found[0]

    def kill(self, place: Path, moment: float) -> str:
        """Ends it after that share of its usual time: "finished", or the output that is there: "old", "new", "begun"."""
        old = self._prepare(place)
        child = self.start(place / self.out)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(moment * self.seconds)
        finished = child.poll() is not None
        self.end(child)
        child.communicate()
        found = self._found(place, old, f"killed after {moment:.2f} of its time")
        self._must_end_well(place, f"killed after {moment:.2f} of its time")
        return "finished" if finished else found

    def fill(self, place: Path, free: int) -> str:
        """Runs it where so many bytes are free: "refused" in one line, or "new" where they were enough."""
        old = self._prepare(place)
        told_of = f"with {free} bytes free"
        with filled(place, free):
            status, said = self.run(place / self.out)
            lines = [line for line in without_progress(said) if line.startswith("snerg-") and ": warning: " not in line]
            if status not in (0, 2) or "Traceback" in said or (status == 2 and not 1 <= len(lines) <= self.voices):
                self.problems.append(f"{self.name} {told_of}: status {status}: {said[-600:]}")
            found = self._found(place, old, told_of)
            if status == 0 and digest(place / self.out) != self.expected:
                self.problems.append(f"{self.name} {told_of}: status 0, and the output is {found}")
        self._must_end_well(place, told_of)
        return "refused" if status else "new"

    def _prepare(self, place: Path) -> str:
        for path in place.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        if self.older is not None:
            self.older(place / self.out)
        return digest(place / self.out)

    def _found(self, place: Path, old: str, told_of: str) -> str:
        if self.older is None:
            return "begun"
        now = digest(place / self.out)
        if now not in (old, self.expected):
            self.problems.append(f"{self.name} {told_of}: neither the old output nor the new one: {now[:200]}")
        return "new" if now == self.expected else "old"

    def _must_end_well(self, place: Path, told_of: str) -> None:
        began = time.monotonic()
        status, said = self.run(place / self.out)
        if self.older is not None:  # so that the next kill falls within its time, however busy the machine is now
            self.seconds = time.monotonic() - began
        if status or digest(place / self.out) != self.expected:
            self.problems.append(f"{self.name} {told_of}: the same line again: status {status}: {said[-600:]}")
        if left := [path.name for path in place.iterdir() if path.name != self.out]:
            self.problems.append(f"{self.name} {told_of}: left behind: {left}")


def digest(path: Path) -> str:
    """Of all that matters of an output: pixels and voxels, and the arrays of a run's last checkpoint."""
    if (path / "run").is_dir() or (path / "checkpoints").is_dir():
        from training.checkpoints import list_checkpoints, read_checkpoint

        run = path / "run" if (path / "run").is_dir() else path
        try:
            arrays = read_checkpoint(list_checkpoints(run / "checkpoints")[-1][1])[1]
        except Exception as error:
            return f"no checkpoint: {error!r}"
        parts = [name.encode() + array.tobytes() for name, array in sorted(arrays.items())]
        if run != path:
            parts.append(digest(path / "pack").encode())
        return hashlib.sha256(b"".join(parts)).hexdigest()
    if path.suffix == ".mp4" and path.exists():
        return _of_film(path)
    if path.is_dir():
        return hashlib.sha256(b"".join(f.name.encode() + _content(f) for f in sorted(path.iterdir()))).hexdigest()
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else "nothing"


def _of_film(path: Path) -> str:
    """Of its pictures' times, and which of the films seen before it looks like: x264 makes of the same pictures now these
    bytes, now others, and its pictures then differ by some levels.
    """
    import av
    from av.error import FFmpegError

    try:
        with av.open(str(path), format="mp4") as container:
            seen = [(str(f.time), f.to_ndarray(format="gray")) for f in container.decode(video=0)]
        times, pictures = ",".join(time for time, _ in seen), np.stack([picture for _, picture in seen]).astype(float)
    except (FFmpegError, IndexError, ValueError) as error:
        return f"no film: {error!r}: {hashlib.sha256(path.read_bytes()).hexdigest()}"
    alike = (k.shape == pictures.shape and np.abs(k - pictures).mean(axis=(1, 2)).max() < LIKE for k in _films)
    number = next((number for number, is_it in enumerate(alike) if is_it), len(_films))
    if number == len(_films):
        _films.append(pictures)
    return f"film {number} of {len(pictures)} pictures at {hashlib.sha256(times.encode()).hexdigest()}"


_films: list[np.ndarray] = []  # each that looked like none before


def _content(file: Path) -> bytes:
    if file.name != "scene_params.json":
        return file.read_bytes()
    document = json.loads(file.read_text(encoding="utf-8"))
    document.get("snerg", {}).pop("provenance", None)  # which holds times
    return json.dumps(document, sort_keys=True).encode()


@contextlib.contextmanager
def filled(place: Path, free: int) -> Iterator[None]:
    """A disk with no more than so many bytes free."""
    ballast, disk = place / "ballast", os.statvfs(place)
    ballast.write_bytes(bytes(max(disk.f_bavail * disk.f_frsize - free, 0)))
    try:
        yield
    finally:
        ballast.unlink()
