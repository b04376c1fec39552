"""A bake shared by several processes through its work folder: the same voxels, whoever made which piece."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from baker.baking.grid import make_grid
from baker.baking.to_pack import share_of
from baker.baking.work_folder import Share, WorkFolder
from baker.commands.bake import main as snerg_bake
from console import UserError
from tests.baker.analytic import ball, culled
from tests.baker.baking.test_grid_and_culling import baked
from tests.scenepack.helpers import edit_json, same_pack
from tests.scenepack.random_packs import BLENDER_FRAME
from tests.stored_runs import SCENE, STORED

ROOT = Path(__file__).parents[3]


@pytest.mark.slow
def test_a_helper_that_dies_costs_no_more_than_its_share(dataset, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("baker.baking.supersample.BLOCKS_AT_ONCE", 2)
    first = WorkFolder(tmp_path / "work", {"bake": 1}, Share(0, 2))
    WorkFolder(tmp_path / "work", {"bake": 1}, Share(1, 2))  # and never makes a piece
    grid = make_grid(np.full(3, -0.9), np.full(3, 0.9), 90, 30, BLENDER_FRAME)
    shared, alone = (baked(culled(ball, grid, dataset, work), grid, work) for work in (first, None))
    assert same_pack(shared, alone)
    first.remove()


def test_shares_come_from_options_or_the_launcher(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("SLURM_STEP_NUM_TASKS", "OMPI_COMM_WORLD_SIZE", "PMI_SIZE"):
        monkeypatch.delenv(name, raising=False)
    assert share_of(None, None) == Share(0, 1)
    assert share_of(4, 3) == Share(3, 4)
    monkeypatch.setenv("SLURM_STEP_NUM_TASKS", "8")
    monkeypatch.setenv("SLURM_PROCID", "5")
    assert share_of(None, None) == Share(5, 8) and share_of(1, 0) == Share(0, 1)
    for processes, process in ((4, None), (None, 1), (4, 4), (0, 0), (2, -1)):
        with pytest.raises(UserError, match="do not fit together"):
            share_of(processes, process)
    monkeypatch.setenv("SLURM_PROCID", "of another meaning")
    assert share_of(None, None) == Share(0, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_as_for_users")
def test_two_processes_of_two_devices_write_the_pack_of_one(tmp_path: Path) -> None:
    run, one, two = tmp_path / "run", tmp_path / "one", tmp_path / "two"
    shutil.copytree(STORED / "multires", run)  # so that nothing is trained here
    # which several devices have, and rounds otherwise than compiled loops
    edit_json(run / "config.json", lambda description: description["config"].update(engine="jax"))
    # without pruning, by rays that two devices may round otherwise
    options = ["--scene", str(SCENE), "--resolution", "60", "--preset", "paper", "--quality", "draft"]
    assert snerg_bake([str(run), "--out", str(one), *options]) == 0
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    environment = os.environ | {"XLA_FLAGS": flags}
    line = [sys.executable, "-m", "snerg", "bake", str(run), "--out", str(two), *options, "--processes", "2"]
    children = [
        subprocess.Popen([*line, "--process-id", i], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True)
        for i in "01"
    ]
    try:
        said = [child.communicate(timeout=300)[0] for child in children]
    finally:
        for child in children:
            child.kill()
    assert [child.returncode for child in children] == [0, 0], said
    assert "pieces of it made here" in said[1]
    expected, found = ({path.name: path.read_bytes() for path in pack.iterdir()} for pack in (one, two))
    assert found == expected
    assert not list(tmp_path.glob(".*.bake"))
