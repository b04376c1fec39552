"""Commands that are ended with kill -9 at random moments, or whose disk is full: python -m tools.fuzz.interruptions --times 40

Each writes to a place where an older output is, but for training and making, which go on with what they find. Afterwards that
output or the new one must be there, whole, and the same command must end with the new one and with nothing else beside it.
What falls short is printed; the exit status is then 1. Disks are tmpfs that is filled, where that can be mounted.
"""

import argparse
import contextlib
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from PIL import Image

from scenepack import save_pack
from tests.viewer.conftest import toy_pack
from tests.viewer.screen import virtual_screen
from tools.fuzz.several_processes import ExportingWindow, MakingWindow, SharingBake
from tools.fuzz.writer import COMMANDS, STEPS, Writer
from tools.procedural import write_procedural_scene

WINDOWS = ("export", "window")  # of snerg-view
NAMES = (*COMMANDS, "sharing", *WINDOWS)  # sharing: two bakes of one pack; see tools.fuzz.several_processes
DISK = "64m"  # enough for each of them where it is empty
TRAINING = ["--preset", "tiny", "--steps", STEPS, "--checkpoint-every", "15", "--validate-every", "30"]
BAKING = ["--resolution", "40", "--quality", "draft"]


@contextlib.contextmanager
def small_disk(place: Path) -> Iterator[bool]:
    """Mounts a disk at `place`; False where that is not permitted."""
    words = ["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(place)]
    mounted = shutil.which("mount") is not None and subprocess.run(words, capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", str(place)], check=True)


def writers(base: Path) -> list[Writer]:
    """All of them, over a scene, a run and two packs that are made in `base`."""
    scene, run, pack = base / "scene", base / "run", base / "pack"
    write_procedural_scene(scene, size=24, views=6, subpixels=1)
    train = Writer("train", [str(scene), *TRAINING], "run")
    if (made := train.run(run))[0]:
        raise RuntimeError(f"there is no run: {made[1][-2000:]}")
    save_pack(toy_pack(), pack)

    def older_pack(out: Path) -> None:
        save_pack(toy_pack(seed=1), out)

    def older_picture(out: Path) -> None:
        Image.new("RGB", (8, 8)).save(out, format="PNG")

    view = [str(pack), "--size", "160x160"]
    return [
        train,
        Writer("make", [str(scene), *TRAINING[:4], "--resolution", "40", "--no-view"], "made"),
        Writer("bake", [str(run), *BAKING], "baked", older_pack),
        SharingBake("sharing", [str(run), *BAKING], "baked", older_pack),
        Writer("convert", ["convert", str(pack), "--codec", "webp"], "converted", older_pack),
        Writer("picture", [str(pack), "--size", "800x800"], "picture.png", older_picture),
        Writer("film", [*view, "--orbit", "24"], "film.mp4", lambda out: out.write_bytes(b"older")),
        ExportingWindow(
            "export", [str(pack), "--export-size", "96x72"], "film.mp4", lambda out: out.write_bytes(b"older")
        ),
        MakingWindow("window", [str(scene)], "made"),
    ]


def campaign(names: list[str], times: int, disks: int, seed: int) -> tuple[str, list[str]]:
    """The table, and what fell short."""
    rows = [
        "| command | kills | had finished | old output | new output | disks | refused | problems |",
        "| --- " * 8 + "|",
    ]
    problems = []
    moments = random.Random(seed)
    with tempfile.TemporaryDirectory(prefix="snerg-interruptions-") as folder, contextlib.ExitStack() as stack:
        base, place, disk = (Path(folder) / name for name in ("base", "place", "disk"))
        base.mkdir()
        disk.mkdir()
        if set(names) & set(WINDOWS):
            os.environ |= {"DISPLAY": stack.enter_context(virtual_screen())[0], "XDG_CONFIG_HOME": str(base / "home")}
            os.environ.pop("WAYLAND_DISPLAY", None)
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(base / "compiled"))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        for writer in writers(base):
            if writer.name not in names:
                continue
            writer.measure(place)
            size = sum(f.stat().st_size for f in [place / writer.out, *place.rglob("*")] if f.is_file())
            kills: Counter[str] = Counter()
            for number in range(times):
                kills[writer.kill(place, moments.uniform(0.25, 1.05))] += 1
                if number % 10 == 9:
                    print(f"{writer.name}: {number + 1} kills, {len(writer.problems)} problems", flush=True)
            with small_disk(disk) as mounted:
                count = disks if mounted else 0
                fits = Counter(writer.fill(disk, int(moments.uniform(0, 1.1) * size)) for _ in range(count))
            outputs = [kills["old"], kills["new"]] if writer.older is not None else ["–", "–"]
            found = [sum(kills.values()), kills["finished"], *outputs, count, fits["refused"]]
            rows.append(f"| {writer.name} | {' | '.join(map(str, found))} | {len(writer.problems)} |")
            print(rows[-1], *writer.problems, sep="\n", flush=True)
            problems += writer.problems
    return "\n".join(rows), problems


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz.interruptions", description=__doc__)
    parser.add_argument("--times", type=int, default=40, help="kills of each command (default 40)")
    parser.add_argument("--disks", type=int, default=10, help="full disks under each command (default 10)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=NAMES, action="append", help="one command; may be given several times")
    given = parser.parse_args()
    table, problems = campaign(given.only or list(NAMES), given.times, given.disks, given.seed)
    print(table)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
