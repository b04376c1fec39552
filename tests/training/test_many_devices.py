"""One device, and two processes of two devices each: the same losses, and one set of files.

python -m tests.training.test_many_devices SCENE OUT ONE [COORDINATOR PROCESSES PROCESS_ID]

trains the paper's method for 50 steps on the devices that this process finds; OUT/run becomes the run. ONE is the OUT of the
process of one device, which leaves there what the others take from there: states/K.npz, its state before step K, for each K of
SHARED. Each OUT gets after/K.npz: the state, and the loss, that step K makes of that.
"""

import dataclasses
import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from training.checkpoints import list_checkpoints, read_checkpoint
from training.config import TINY
from training.devices import is_writer, join_processes

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
# Of the largest value of an array. Measured on an AMD EPYC, also without FMA and with other kernels of oneDNN: at most 2e-6.
A_STEPS_ROUNDING = 2e-5

# NeRF's endless last interval makes a ray opaque or clear by the sign of one density: the last bit of a sum would show.
CONFIG = dataclasses.replace(
    TINY, batch_size=128, steps=50, log_every=1, checkpoint_every=25, validate_every=0,
    nerf=dataclasses.replace(TINY.nerf, depth=2, width=16, skip_after=0, coarse_samples=8, fine_samples=8, warmup_steps=5,
                             last_interval=0.5),
)  # fmt: skip
SHARED = (0, 1, 2, 3, 4, 25, 40)


def start(scene: Path, out: Path, *more: str, devices: int = 1) -> subprocess.Popen[str]:
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
    environment |= {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    words = [str(scene), str(out), str(out.parent / "one"), *more]
    line = [sys.executable, "-m", "tests.training.test_many_devices", *words]
    return subprocess.Popen(line, cwd=ROOT, env=environment, stderr=subprocess.PIPE, text=True)


def finish(*children: subprocess.Popen[str]) -> None:
    try:
        for child in children:
            _, errors = child.communicate(timeout=900)
            assert child.returncode == 0, errors[-3000:]
    finally:
        for child in children:
            child.kill()


@pytest.fixture(scope="module")
def trained(procedural_path: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of runs trained on one device, and by two processes of two devices each."""
    out = tmp_path_factory.mktemp("devices")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    finish(start(procedural_path, out / "one"))  # first: the others begin steps with its states
    finish(
        start(procedural_path, out / "two", address, "2", "0", devices=2),
        start(procedural_path, out / "two", address, "2", "1", devices=2),
    )
    return {name: out / name for name in ("one", "two")}


@pytest.mark.parametrize("step", SHARED)
def test_a_step_from_the_same_state_is_that_of_one_device(trained: dict[str, Path], step: int) -> None:
    """Adam's first moment holds the gradient; all else of the state, and the loss, must agree as well."""
    with (
        np.load(trained["one"] / "states" / f"{step}.npz") as before,
        np.load(trained["one"] / "after" / f"{step}.npz") as expected,
        np.load(trained["two"] / "after" / f"{step}.npz") as found,
    ):
        assert set(found.files) == set(expected.files)
        moved = 0
        for name in expected.files:
            scale = np.abs(expected[name]).max(initial=0)
            rounding = A_STEPS_ROUNDING * scale if np.issubdtype(expected[name].dtype, np.floating) else 0
            np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=rounding, err_msg=name)
            if name in before.files and before[name].shape == expected[name].shape:
                moved += np.abs(expected[name] - before[name]).max(initial=0) > 100 * rounding
        assert moved >= 3, "the step did more than rounding can"


def test_two_processes_leave_the_files_of_one(trained: dict[str, Path]) -> None:
    one, two = (trained[name] / "run" for name in ("one", "two"))
    names = [sorted(str(path.relative_to(run)) for path in run.rglob("*")) for run in (one, two)]
    assert names[0] == names[1]
    description = json.loads((two / "config.json").read_text())
    assert description["provenance"]["processes"] == 2 and description["provenance"]["device"].startswith("4 x")
    (_, ours), (_, theirs) = (read_checkpoint(list_checkpoints(run / "checkpoints")[-1][1]) for run in (two, one))
    assert {n: a.shape for n, a in ours.items()} == {n: a.shape for n, a in theirs.items()}


def main(scene: str, out: str, one: str, coordinator: str = "", processes: str = "1", process_id: str = "0") -> None:
    if coordinator:
        join_processes(coordinator, int(processes), int(process_id))
    from training.loop import train

    method, states, after = train(scene, Path(out) / "run", CONFIG).method, Path(one) / "states", Path(out) / "after"
    if out == one:
        states.mkdir()
        state = method.start(jax.random.PRNGKey(CONFIG.seed))
        for step in range(max(SHARED) + 1):
            if step in SHARED:
                np.savez(states / f"{step}.npz", **method.save(state))  # type: ignore[arg-type]
            state, _ = method.step(state, step)
    for step in SHARED:
        with np.load(states / f"{step}.npz") as arrays:
            state, metrics = method.step(method.restore(dict(arrays)), step)
        arrays, loss = method.save(state), float(metrics["loss"])
        if is_writer():
            after.mkdir(exist_ok=True)
            np.savez(after / f"{step}.npz", loss=loss, **arrays)  # type: ignore[arg-type]


if __name__ == "__main__":
    main(*sys.argv[1:])
