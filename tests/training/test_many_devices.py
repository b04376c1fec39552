"""One device, eight devices, and two processes: the same losses, and one set of files."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from jax.sharding import Mesh

from console import UserError
from training.checkpoints import list_checkpoints, read_checkpoint
from training.devices import join_processes, own_rows
from training.journal import read_journal

ROOT = Path(__file__).parents[2]


def start(scene: Path, out: Path, *more: str, devices: int = 1) -> subprocess.Popen[str]:
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment |= {"XLA_FLAGS": f"--xla_force_host_platform_device_count={devices}", "JAX_PLATFORMS": "cpu"}
    line = [sys.executable, "-m", "tests.training.train_both", str(scene), str(out), *more]
    return subprocess.Popen(line, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module")
def trained(procedural_path: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of runs trained on one device, on eight, and by two processes of one device each."""
    out = tmp_path_factory.mktemp("devices")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    children = [
        start(procedural_path, out / "one"),
        start(procedural_path, out / "eight", devices=8),
        start(procedural_path, out / "two", address, "2", "0"),
        start(procedural_path, out / "two", address, "2", "1"),
    ]
    try:
        for child in children:
            _, errors = child.communicate(timeout=300)
            assert child.returncode == 0, errors[-3000:]
    finally:
        for child in children:
            child.kill()
    return {name: out / name for name in ("one", "eight", "two")}


@pytest.mark.parametrize("method", ["nerf", "voxels"])
@pytest.mark.parametrize("devices", ["eight", "two"])
def test_fifty_steps_have_the_losses_of_one_device(trained: dict[str, Path], devices: str, method: str) -> None:
    expected, found = (
        {r["step"]: r["loss"] for r in read_journal(trained[which] / method / "metrics.jsonl") if "loss" in r}
        for which in ("one", devices)
    )
    assert list(found) == list(expected) == list(range(1, 51)), "each step once: one process alone writes"
    np.testing.assert_allclose(list(found.values()), list(expected.values()), rtol=0, atol=1e-4)


@pytest.mark.parametrize("method", ["nerf", "voxels"])
def test_two_processes_leave_the_files_of_one(trained: dict[str, Path], method: str) -> None:
    names = [sorted(str(p.relative_to(trained[w])) for p in (trained[w] / method).rglob("*")) for w in ("one", "two")]
    assert names[0] == names[1]
    description = json.loads((trained["two"] / method / "config.json").read_text())
    assert description["provenance"]["processes"] == 2 and description["provenance"]["device"].startswith("2 x")
    (_, ours), (_, theirs) = (
        read_checkpoint(list_checkpoints(trained[w] / method / "checkpoints")[-1][1]) for w in ("two", "one")
    )
    assert {n: a.shape for n, a in ours.items()} == {n: a.shape for n, a in theirs.items()}


def test_rows_are_shared_out_evenly_and_padded() -> None:
    from training.devices import AXIS, every_device

    assert own_rows(1000, Mesh(np.array(jax.devices()[:1]), (AXIS,))) == (0, 1000)
    assert own_rows(1001, every_device())[1] >= 1001


@pytest.mark.parametrize("told", [("127.0.0.1:1", None, None), (None, 2, 0), ("127.0.0.1:1", 2, 5)])
def test_half_told_processes_are_refused_in_one_line(told, monkeypatch) -> None:
    def initialize(coordinator, processes, process_id):
        if None in (coordinator, processes, process_id) or process_id >= processes:
            raise ValueError("coordinator_address should be defined.")

    monkeypatch.setattr(jax.distributed, "initialize", initialize)
    with pytest.raises(UserError, match="could not be joined"):
        join_processes(*told)


def test_a_launcher_tells_its_processes_apart(monkeypatch) -> None:
    calls = []
    monkeypatch.setattr(jax.distributed, "initialize", lambda *told: calls.append(told))
    join_processes()
    assert calls == [], "alone, nothing is joined"
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "4")
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "3")
    join_processes()
    join_processes("host:1234")
    assert calls == [(None, None, None), ("host:1234", 4, 3)]
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "1")
    join_processes()
    assert len(calls) == 2, "a launcher of one process is no company"
