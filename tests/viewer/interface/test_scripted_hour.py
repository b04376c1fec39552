"""A few minutes of the hour that `make events` plays."""

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
from tests.viewer.rendering.shapes import shapes_pack

REPOSITORY = Path(__file__).parents[3]


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


# Opening many packs leaves nothing behind: neither in our memory nor on the card

TOLERATED = 0.02
WARM_UP, PACKS, ROUNDS = 15, 30, 3


@pytest.mark.slow
def test_thirty_packs_opened_from_disk_and_closed_leave_memory_where_it_was(tmp_path: Path) -> None:
    if not Path("/proc/self/statm").exists():
        pytest.skip("this system does not tell what a process holds as Linux does")
    save_pack(shapes_pack(84), tmp_path / "a")
    save_pack(shapes_pack(70), tmp_path / "b")
    save_pack(shapes_pack(70, diffuse=True), tmp_path / "c")
    shutil.make_archive(str(tmp_path / "b"), "zip", tmp_path / "b")
    packs = [str(tmp_path / name) for name in ("a", "b.zip", "c")]
    held = run_module("many_packs", *map(str, (WARM_UP, PACKS, ROUNDS, TOLERATED)), *packs)
    assert len(set(held["card"])) == len(set(held["descriptors"])) == 1
    host = held["host"]
    grown = [after / before - 1 for before, after in pairwise(host)]
    assert min(grown) < TOLERATED, [f"{bytes_held / 2**20:.1f} MiB" for bytes_held in host]
    forgotten = PACKS * load_pack(tmp_path / "c").atlas_rgba.nbytes
    assert forgotten > 4 * TOLERATED * max(host)  # the smallest pack, if kept every time, would be far beyond the bound
