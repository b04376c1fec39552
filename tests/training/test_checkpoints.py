"""Checkpoints that are damaged or do not fit, and runs in which links lead elsewhere."""

import os
import shutil
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from console import Notice, UserError
from tests.stored_runs import SCENE, STORED
from training.checkpoints import from_arrays, read_newest_checkpoint, write_checkpoint
from training.commands.train import main

ARRAYS = {"weight": np.arange(12, dtype=np.float32).reshape(3, 4), "count": np.array(7, np.int32)}


@pytest.mark.parametrize("damage", ["cut", "flip", "empty"])
def test_a_damaged_checkpoint_is_passed_over_with_a_warning(tmp_path: Path, damage: str):
    write_checkpoint(tmp_path, 10, ARRAYS)
    path = write_checkpoint(tmp_path, 20, ARRAYS)
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[-3] ^= 0x40
    path.write_bytes({"cut": data[: len(data) // 2], "flip": data, "empty": b""}[damage])
    with pytest.warns(Notice, match=r"step_00000020.*damaged.*before"):
        step, _ = read_newest_checkpoint(tmp_path)
    assert step == 10


def test_no_checkpoint_and_no_readable_one_are_errors_with_a_remedy(tmp_path: Path):
    with pytest.raises(UserError, match="no checkpoint"):
        read_newest_checkpoint(tmp_path)
    write_checkpoint(tmp_path, 10, ARRAYS).write_bytes(b"nonsense")
    with pytest.warns(Notice), pytest.raises(UserError, match="can be read"):
        read_newest_checkpoint(tmp_path)


def test_arrays_of_another_shape_or_a_missing_one_are_refused():
    template = {"a": jnp.ones((2, 2))}
    with pytest.raises(UserError, match=r'"a" does not fit.*\[2, 2\].*\[3\]'):
        from_arrays(template, {"a": np.ones(3, np.float32)})
    with pytest.raises(UserError, match=r'"a" does not fit.*found none'):
        from_arrays(template, {})


# Going on with somebody else's run writes into that run, and nowhere else


@pytest.mark.parametrize("name", ["metrics.jsonl", "curves.png", "validation/latest.png", "config.json"])
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_link_or_a_pipe_in_the_place_of_a_file_is_refused(name, kind, tmp_path, capsys):
    run, mine = Path(shutil.copytree(STORED / "multires", tmp_path / "run")), tmp_path / "mine.txt"
    mine.write_bytes((run / name).read_bytes() if name == "config.json" else b"mine")
    before = mine.read_bytes()
    file = run / name
    file.parent.mkdir(exist_ok=True)
    file.unlink(missing_ok=True)
    file.symlink_to(mine) if kind == "link" else os.mkfifo(file)
    assert main([str(SCENE), "--out", str(run), "--resume"]) == 2
    assert file.name in capsys.readouterr().err or name == "config.json"
    assert mine.read_bytes() == before
