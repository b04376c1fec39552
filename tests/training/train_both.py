"""Trains the paper's method for 50 steps on the devices that this process finds: a child process of test_many_devices.

python -m tests.training.train_both SCENE OUT ONE [COORDINATOR PROCESSES PROCESS_ID]

OUT/run becomes the run. ONE is the OUT of the process of one device, which leaves there what the others take from there:
states/K.npz, its state before step K, for each K of SHARED. Each OUT gets after/K.npz: the state, and the loss, that step K
makes of that.
"""

import dataclasses
import sys
from pathlib import Path

import jax
import numpy as np

from training.config import TINY, TrainConfig
from training.devices import is_writer, join_processes
from training.method import Method

# NeRF's endless last interval makes a ray opaque or clear by the sign of one density: the last bit of a sum would show.
CONFIG = dataclasses.replace(
    TINY, batch_size=128, steps=50, log_every=1, checkpoint_every=25, validate_every=0,
    nerf=dataclasses.replace(TINY.nerf, depth=2, width=16, skip_after=0, coarse_samples=8, fine_samples=8, warmup_steps=5,
                             last_interval=0.5),
)  # fmt: skip
SHARED = (0, 1, 2, 3, 4, 25, 40)


def leave_states(method: Method, config: TrainConfig, folder: Path) -> None:
    """Writes states/."""
    folder.mkdir()
    state = method.start(jax.random.PRNGKey(config.seed))
    for step in range(max(SHARED) + 1):
        if step in SHARED:
            np.savez(folder / f"{step}.npz", **method.save(state))  # type: ignore[arg-type]
        state, _ = method.step(state, step)


def take_shared_steps(method: Method, states: Path, out: Path) -> None:
    """Writes after/."""
    for step in SHARED:
        with np.load(states / f"{step}.npz") as arrays:
            state, metrics = method.step(method.restore(dict(arrays)), step)
        after, loss = method.save(state), float(metrics["loss"])
        if is_writer():
            out.mkdir(exist_ok=True)
            np.savez(out / f"{step}.npz", loss=loss, **after)  # type: ignore[arg-type]


def main(scene: str, out: str, one: str, coordinator: str = "", processes: str = "1", process_id: str = "0") -> None:
    if coordinator:
        join_processes(coordinator, int(processes), int(process_id))
    from training.loop import train

    method = train(scene, Path(out) / "run", CONFIG).method
    if out == one:
        leave_states(method, CONFIG, Path(out) / "states")
    take_shared_steps(method, Path(one) / "states", Path(out) / "after")


if __name__ == "__main__":
    main(*sys.argv[1:])
