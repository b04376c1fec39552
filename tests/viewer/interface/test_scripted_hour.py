"""A few minutes of the hour that `make events` plays, and many packs opened from disk, one after the other.

`python -m tests.viewer.interface.test_scripted_hour PACK [PACK ...]` opens the packs in a process of its own. It prints JSON:
host and card, bytes held after WARM_UP packs and after each round of PACKS more, and as many open descriptors. A round in which
no more than the share TOLERATED is added is the last: what is forgotten is forgotten in every round.
"""

import json
import os
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from scenepack import load_pack, save_pack
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.waiting import not_none, until
from tools.fuzz.memory import resident, with_steady_memory
from viewer.app.application import App
from viewer.rendering.offscreen import create_context

REPOSITORY = Path(__file__).parents[3]
TOLERATED = 0.02
WARM_UP, PACKS, ROUNDS = 15, 30, 3


def run_module(name: str, *words: str) -> dict[str, Any]:
    """What a module of this folder prints, as a process of its own."""
    command = [sys.executable, "-m", f"tests.viewer.interface.{name}", *words]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    run = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stdout + run.stderr
    return json.loads(run.stdout.splitlines()[-1])


@pytest.mark.slow
def test_random_use_of_everything_at_once_finds_nothing() -> None:
    played = run_module("scripted_hour", "--events", "90", "--seed", "5")
    assert played["found"] == [] and sum(played["done"].values()) == 90 and len(played["done"]) >= 12


@pytest.mark.slow
def test_thirty_packs_opened_from_disk_and_closed_leave_memory_where_it_was(tmp_path: Path) -> None:
    """Neither in our memory nor on the card is anything left."""
    if not Path("/proc/self/statm").exists():
        pytest.skip("this system does not tell what a process holds as Linux does")
    save_pack(shapes_pack(84), tmp_path / "a")
    save_pack(shapes_pack(70), tmp_path / "b")
    save_pack(shapes_pack(70, diffuse=True), tmp_path / "c")
    shutil.make_archive(str(tmp_path / "b"), "zip", tmp_path / "b")
    held = run_module("test_scripted_hour", *(str(tmp_path / name) for name in ("a", "b.zip", "c")))
    assert len(set(held["card"])) == len(set(held["descriptors"])) == 1
    host = held["host"]
    grown = [after / before - 1 for before, after in pairwise(host)]
    assert min(grown) < TOLERATED, [f"{bytes_held / 2**20:.1f} MiB" for bytes_held in host]
    forgotten = PACKS * load_pack(tmp_path / "c").atlas_rgba.nbytes
    assert forgotten > 4 * TOLERATED * max(host)  # the smallest pack, if kept every time, would be far beyond the bound


def open_and_look(ui: OffscreenUi, path: Path, *, other: bool = False) -> None:
    """Opens a pack from disk as a user does, and draws it."""
    ui.app.open(path, other=other)
    until(lambda: not_none(ui.app.loading).finished)
    ui.frames(4)
    assert ui.app.scene is not None and not ui.app.messages.dialogs


def open_many(packs: list[Path]) -> None:
    ctx, held = create_context(), []
    ui = OffscreenUi(ctx, App(), size=(480, 360))
    ui.app.resolution.enabled = False
    for times in (WARM_UP, *[PACKS] * ROUNDS):
        for i in range(times):  # now and then a second one beside
            open_and_look(ui, packs[i % len(packs)])
            if i % 10 == 4:
                open_and_look(ui, packs[(i + 1) % len(packs)], other=True)
            ui.app.close()
            ui.frames(2)
        held.append((resident(), ui.canvas.gpu_bytes, len(list(Path("/proc/self/fd").iterdir()))))
        if len(held) > 1 and held[-1][0] < (1 + TOLERATED) * held[-2][0]:
            break
    assert ctx.error == "GL_NO_ERROR"
    print(json.dumps(dict(zip(("host", "card", "descriptors"), zip(*held, strict=True), strict=True))))


if __name__ == "__main__":
    with_steady_memory("tests.viewer.interface.test_scripted_hour")
    open_many([Path(pack) for pack in sys.argv[1:]])
