"""Trains, bakes, evaluates, renders, opens and closes, over and over in one process: python -m tools.fuzz.long_run --minutes 120

After each lap nothing may be left: no file, no descriptor, no thread, no process; and over all laps memory stays flat. What
each lap held is printed, and kept as JSON where --json names a file. The exit status is 1 where something grew.

JAX forgets after each lap what it compiled, which it keeps for as long as a program runs: commands run once in a process.
"""

import argparse
import contextlib
import io
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from tools.fuzz.memory import resident, with_steady_memory

WARM_UP = 4  # laps: programs are compiled, pools filled, arenas taken
FEWEST = 4  # laps after these
TOLERATED = 0.03  # of what was held after the warm-up: allocators keep memory for later, in steps that come at any time
SAVING = ["--checkpoint-every", "20", "--validate-every", "20"]
TRAININGS = (  # one of each method, as long as there is something to bake
    ["--preset", "tiny", "--batch-size", "64", "--steps", "40", *SAVING],
    ["--preset", "quick", "--steps", "120", *SAVING],
)
BAKING = ["--resolution", "30"]


@dataclass(frozen=True)
class Lap:
    """What is held after one: bytes of memory, open descriptors, threads, processes that it started; files left behind."""

    seconds: float
    memory: int
    descriptors: int
    threads: int
    processes: int
    left: list[str]


def verdict(laps: Sequence[Lap]) -> list[str]:
    """What grew after the warm-up, in one line each."""
    found = [f"lap {i}: left behind: {lap.left[:5]}" for i, lap in enumerate(laps) if lap.left]
    measured = laps[WARM_UP:]
    if len(measured) < FEWEST:
        return [*found, f"{len(laps)} laps are too few: give it more minutes"]
    for name in ("descriptors", "threads", "processes"):
        before, after = getattr(measured[0], name), getattr(measured[-1], name)
        if after > before:
            found.append(f"{name}: {before}, and {after} {len(measured) - 1} laps later")
    quarter = len(measured) // 4
    early, late = (median(lap.memory for lap in some) for some in (measured[:quarter], measured[-quarter:]))
    if late > (1 + TOLERATED) * early:
        found.append(f"memory: {early / 2**20:.0f} MiB early, {late / 2**20:.0f} MiB late, of {len(measured)} laps")
    return found


def held(place: Path, seconds: float) -> Lap:
    """What this process holds now. Linux alone tells."""
    own = Path("/proc/self")
    return Lap(
        seconds,
        resident(),
        len(list((own / "fd").iterdir())),
        len(list((own / "task").iterdir())),
        sum(1 for task in (own / "task").iterdir() for _ in (task / "children").read_text().split()),
        sorted(str(path.relative_to(place)) for path in place.rglob("*")),
    )


def lap_of(scene: Path, place: Path, training: list[str], look: Callable[[Path], None]) -> None:
    """All that is done with one scene; its files are removed again, by name: what else is there was left behind."""
    from baker.commands.bake import main as snerg_bake
    from baker.commands.evaluate import main as snerg_eval
    from training.commands.train import main as snerg_train
    from viewer.commands.render import main as snerg_render

    run, pack, picture, film = (place / name for name in ("run", "pack", "picture.png", "film.mp4"))
    lines = (
        (snerg_train, [str(scene), "--out", str(run), *training]),
        (snerg_bake, [str(run), "--out", str(pack), *BAKING]),
        (snerg_eval, [str(pack), "--scene", str(scene)]),
        (snerg_render, [str(pack), "--out", str(picture), "--size", "64x64"]),
        (snerg_render, [str(pack), "--out", str(film), "--size", "64x64", "--orbit", "8"]),
    )
    for command, words in lines:
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            status = command(words)
        if status != 0:
            raise RuntimeError(f"{command.__module__} {' '.join(words)}: status {status}: {said.getvalue()[-2000:]}")
    look(pack)
    shutil.rmtree(run)
    shutil.rmtree(pack)
    picture.unlink()
    film.unlink()


def run(minutes: float, base: Path, tell: Callable[[Lap], None]) -> list[Lap]:
    """Laps until the time is over."""
    import jax
    import moderngl

    from tests.viewer.interface.test_scripted_hour import open_and_look
    from tests.viewer.offscreen_ui import OffscreenUi
    from tools.procedural import write_procedural_scene
    from viewer.app.application import App

    scene, place = base / "scene", base / "place"
    write_procedural_scene(scene, size=24, views=6, subpixels=1)
    place.mkdir()
    tempfile.tempdir = os.environ["TMPDIR"] = str(place)  # what is forgotten there is seen as well
    ctx = moderngl.create_context(standalone=True, backend="egl")  # pyright: ignore[reportArgumentType]
    ui = OffscreenUi(ctx, App(), size=(480, 360))

    def look(pack: Path) -> None:
        open_and_look(ui, pack)
        ui.app.close()
        ui.frame()
        ui.frame()

    laps, end = [], time.monotonic() + 60 * minutes
    while time.monotonic() < end:
        began = time.monotonic()
        for training in TRAININGS:
            lap_of(scene, place, training, look)
        jax.clear_caches()
        laps.append(held(place, time.monotonic() - began))
        tell(laps[-1])
    return laps


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz.long_run", description=__doc__)
    parser.add_argument("--minutes", type=float, default=120.0, help="how long (default 120)")
    parser.add_argument("--json", type=Path, help="file for what each lap held")
    given = parser.parse_args()
    with_steady_memory("tools.fuzz.long_run")
    if threading.active_count() > 1 or not Path("/proc/self/statm").exists():
        parser.error("this needs Linux, which tells what a process holds, and a process of its own")

    def tell(lap: Lap) -> None:
        figures = f"{lap.descriptors} descriptors, {lap.threads} threads, {lap.processes} processes"
        print(f"{lap.memory / 2**20:8.1f} MiB, {figures}, {len(lap.left)} files, {lap.seconds:.0f} s", flush=True)

    with tempfile.TemporaryDirectory(prefix="snerg-long-run-") as folder:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(folder) / "compiled"))
        laps = run(given.minutes, Path(folder), tell)
    if given.json is not None:
        given.json.write_text(json.dumps([asdict(lap) for lap in laps]))
    problems = verdict(laps)
    print(*(problems or [f"{len(laps)} laps: nothing is left behind, memory is flat"]), sep="\n")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
