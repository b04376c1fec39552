"""The process that opens spoilt files, one after another, and says what came of each: `python -m tests.fuzz.child`.

It reads one recipe a line from stdin and answers with one line of JSON. Memory is limited to what the valid files need
and LEEWAY; the parent (tests.fuzz.workers) watches over the time.
"""

import faulthandler
import importlib
import json
import os
import re
import resource
import shutil
import sys
import traceback
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from console import Notice, UserError, refusal
from console.errors import missing_extra
from tests.fuzz.mutations import apply
from tests.fuzz.trees import ARCHIVE, Tree, read_tree, write_tree
from tests.fuzz.words import Unfit, require_words

ROOT = Path(__file__).parents[2]
LEEWAY = 1 << 30  # bytes above what valid files need
OPENED, REFUSED, FINDING = "opened", "refused", "finding"
UNSEEN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)  # Python shows none of them
_OUT_OF_MEMORY = re.compile("out of memory|RESOURCE_EXHAUSTED|bad_alloc", re.IGNORECASE)
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_CHANGING = {"os.remove", "os.rename", "os.rmdir", "os.mkdir", "shutil.rmtree", "os.truncate", "os.link", "os.symlink"}
_STARTING = {"os.system", "os.exec", "os.posix_spawn", "os.startfile", "socket.connect", "socket.bind", "ctypes.dlopen"}


@dataclass(frozen=True)
class Outcome:
    """kind: OPENED, REFUSED or FINDING. key: the same for findings that have the same cause. line: what was said."""

    kind: str
    key: str = ""
    line: str = ""


class Subject:
    """One of packs, scenes, settings, runs; where its files are made and opened."""

    def __init__(self, name: str, bases: Path, place: Path) -> None:
        self.name, self.place = name, place
        self.module: Any = importlib.import_module(f"tests.fuzz.{name}")
        self.trees: dict[str, Tree] = {base: read_tree(bases / name / base) for base in self.module.BASES}
        self.trespasses: list[str] = []

    def outcome(self, recipe: dict[str, Any]) -> Outcome:
        """What comes of one recipe."""
        path = self._written(recipe)
        self.trespasses.clear()
        Path("/proc/self/clear_refs").write_text("5")  # VmHWM begins anew
        before = _status("VmRSS")
        try:
            with warnings.catch_warnings(record=True, action="always") as caught:
                found = self._opened(path, recipe["base"])
            found = found if found.kind == FINDING else _of_warnings(caught) or found
            if self.trespasses:
                return Outcome(FINDING, f"trespass {self.trespasses[0].split()[0]}", self.trespasses[0])
            if _status("VmHWM") - before > LEEWAY:
                return Outcome(FINDING, "memory", f"{(_status('VmHWM') - before) >> 20} MiB")
            return found
        finally:
            shutil.rmtree(self.place / "here", ignore_errors=True)

    def _written(self, recipe: dict[str, Any]) -> Path:
        folder = self.place / "here"
        shutil.rmtree(folder, ignore_errors=True)
        tree = apply(self.trees[recipe["base"]], recipe["steps"])
        archive = tree.pop(ARCHIVE, None)
        write_tree(tree, folder / "subject")
        if not isinstance(archive, bytes):
            return folder / "subject"
        (folder / "subject.zip").write_bytes(archive)
        return folder / "subject.zip"

    def _opened(self, path: Path, base: str) -> Outcome:
        try:
            self.module.open_it(path, base)
            return Outcome(OPENED)
        except Exception as error:
            if _lacks_memory(error):
                return Outcome(FINDING, "memory", _frame(error))
            line = str(error) if isinstance(error, UserError) else refusal(error) or missing_extra(error)
            if line is None:
                what = traceback.format_exception_only(error)[-1].strip()
                return Outcome(FINDING, f"{type(error).__name__} {_frame(error)}", what[:400])
            line = line.replace(str(path), "PATH")
            try:
                require_words(line)
            except Unfit as unfit:
                return Outcome(FINDING, f"words {_frame(error)}", f"{unfit}: {line[:200]!r}")
            return Outcome(REFUSED, "", line)

    def watch(self) -> None:
        """From now on, whatever is written, started or connected to outside of the own folder is noted."""
        inside = (str(self.place), "/dev/null", "/proc/self/")

        def hook(event: str, arguments: tuple[Any, ...]) -> None:
            if event == "open":
                file, _, flags = arguments
                writes = isinstance(flags, int) and flags & _WRITING
                if writes and isinstance(file, str) and not file.startswith(inside):
                    self.trespasses.append(f"writes {file}")
            elif event in _CHANGING:
                file = os.fspath(arguments[0]) if not isinstance(arguments[0], int) else ""
                if isinstance(file, str) and not file.startswith(inside) and os.path.isabs(file):
                    self.trespasses.append(f"{event} {file}")
            elif event in _STARTING or (event == "subprocess.Popen" and arguments[0] != sys.executable):
                self.trespasses.append(f"{event} {arguments!r}"[:200])

        sys.addaudithook(hook)


def _of_warnings(caught: list[warnings.WarningMessage]) -> Outcome | None:
    """A finding where a warning is not fit to be shown, or is one that tells a user nothing."""
    for warning in caught:
        text = str(warning.message)
        if issubclass(warning.category, UNSEEN):
            continue
        if not issubclass(warning.category, Notice):
            place = Path(warning.filename).name
            if "/PIL/" in warning.filename:  # of what it reads past; commands do not show it
                continue
            return Outcome(FINDING, f"{warning.category.__name__} {place}:{warning.lineno}", text[:200])
        try:
            require_words(text)
        except Unfit as unfit:
            return Outcome(FINDING, "words of a notice", f"{unfit}: {text[:200]!r}")
    return None


def _lacks_memory(error: BaseException | None) -> bool:
    """Whether memory ran out, however it was told afterwards; not where it was found too small beforehand."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or _OUT_OF_MEMORY.search(str(error)):
            return True
        error = error.__cause__ or error.__context__
    return False


def _frame(error: BaseException) -> str:
    """The deepest line of ours, without its number, that an exception went through."""
    ours = [
        f"{Path(frame.filename).relative_to(ROOT)}:{frame.name}"
        for frame in traceback.extract_tb(error.__traceback__)
        if frame.filename.startswith(str(ROOT)) and ".venv" not in frame.filename and "/tests/" not in frame.filename
    ]
    return ours[-1] if ours else "tests"


def _status(name: str) -> int:
    """A line of /proc/self/status, in bytes."""
    row = next(row for row in Path("/proc/self/status").read_text().splitlines() if row.startswith(name + ":"))
    return int(row.split()[1]) * 1024


def main() -> None:
    subject = Subject(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    nothing = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)  # what decoders print
    faulthandler.enable()
    for base in subject.trees:  # the most that valid files need
        found = subject.outcome({"base": base, "steps": []})
        if found.kind != OPENED:
            raise SystemExit(f"the valid {base} of {subject.name} is not opened: {found}")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (_status("VmPeak") + LEEWAY, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (LEEWAY, resource.RLIM_INFINITY))
    if subject.name != "runs":  # whose libraries keep caches of what they compile
        subject.watch()
    print(json.dumps({"ready": True}), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(asdict(subject.outcome(json.loads(line)))), file=answers, flush=True)


if __name__ == "__main__":
    main()
