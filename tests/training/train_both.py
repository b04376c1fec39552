"""Trains both methods for 50 steps on the devices that this process finds: a child process of test_many_devices.

python -m tests.training.train_both SCENE OUT ONE [COORDINATOR PROCESSES PROCESS_ID]

OUT/METHOD becomes the run. ONE is the OUT of the process of one device. That one also leaves there, and the others take
from there:

    METHOD/states/K.npz   its state before step K, for each K of SHARED
    METHOD/after/K.npz    (in each OUT) the state, and the loss, that step K makes of that
    METHOD/twins.npy      losses [TWINS, 50] of the same training with rounding errors of another kind: see twin()
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from training.config import TINY, TrainConfig
from training.devices import is_writer, join_processes
from training.method import Method

EVERY = {"steps": 50, "log_every": 1, "checkpoint_every": 25, "validate_every": 0}
# NeRF's endless last interval makes a ray opaque or clear by the sign of one density: the last bit of a sum would show.
SMALL = {"depth": 2, "width": 16, "skip_after": 0, "coarse_samples": 8, "fine_samples": 8, "warmup_steps": 5}
NERF = dataclasses.replace(TINY.nerf, **SMALL, last_interval=0.5)
CONFIGS: dict[str, TrainConfig] = {"nerf": dataclasses.replace(TINY, batch_size=128, **EVERY, nerf=NERF)}
SHARED = (0, 1, 2, 3, 4, 25, 40)
TWINS = 4


def run_of(method: Method, state: Any, steps: int, before: Callable[[Any, int], Any]) -> list[float]:
    """The losses of so many steps. before(state, step) gives the state that a step begins with."""
    losses = []
    for step in range(steps):
        state, metrics = method.step(before(state, step), step)
        losses.append(float(metrics["loss"]))
    return losses


def twin(method: Method, arrays: dict[str, np.ndarray], rng: np.random.Generator) -> Any:
    """The state of `arrays`, each number that is trained moved to the float above it, below it, or not at all.

    That is what sums in another order do to a step, and they may do it at each.
    """
    moved = {}
    for name, array in arrays.items():
        trained = name.startswith(("params/", "values."))
        towards = np.where(rng.random(array.shape) < 0.5, -np.inf, np.inf).astype(np.float32)
        choice = rng.random(array.shape) < 2 / 3
        moved[name] = np.where(choice, np.nextafter(array, towards), array) if trained else array
    assert any(not np.array_equal(moved[name], array) for name, array in arrays.items())
    return method.restore(moved)


def leave_for_others(method: Method, config: TrainConfig, folder: Path) -> None:
    """Writes states/ and twins.npy."""
    (folder / "states").mkdir()

    def begin() -> Any:
        return method.start(jax.random.PRNGKey(config.seed))

    def keep(state: Any, step: int) -> Any:
        if step in SHARED:
            np.savez(folder / "states" / f"{step}.npz", **method.save(state))  # type: ignore[arg-type]
        return state

    run_of(method, begin(), max(SHARED) + 1, keep)
    losses = []
    for seed in range(TWINS):
        rng = np.random.default_rng(seed)
        moved = run_of(method, begin(), config.steps, lambda state, _, rng=rng: twin(method, method.save(state), rng))
        losses.append(moved)
    np.save(folder / "twins.npy", losses)


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

    for name, config in CONFIGS.items():
        folder = Path(out) / name
        method = train(scene, folder / "run", config).method
        if out == one:
            leave_for_others(method, config, folder)
        take_shared_steps(method, Path(one) / name / "states", folder / "after")


if __name__ == "__main__":
    main(*sys.argv[1:])
