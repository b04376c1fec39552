"""The seam between the fast method and what computes its steps, so that one field can be trained by several programs.

Between steps everything is shared: the dense start, pruning, refining, whole pictures, checkpoints. These work on a
VoxelState, plain arrays; an engine keeps what it makes of one in a form of its own, from `begin` to `end`.
"""

from __future__ import annotations

import importlib.util
import warnings
from typing import Any, Protocol

import jax

from console import Notice, UserError
from training.config import EngineName
from training.dataset import RayDataset
from training.voxels.settings import Plan, Settings
from training.voxels.state import VoxelState
from training.voxels.step import JaxEngine


class Engine(Protocol):
    """What makes the steps: training.voxels.step.JaxEngine, or another that agrees with it to rounding.

    Agreement is defined by training.voxels.step.loss_and_gradient of a Batch. What is random about a step comes from the
    seed and the step alone; two engines may draw differently.
    """

    def begin(self, state: VoxelState) -> Any:
        """The engine's own form of a state, which `step` may change in place. Cheap: a state may never be stepped."""
        ...

    def end(self, state: Any) -> VoxelState:
        """The inverse of begin; the state stays as it is."""
        ...

    def step(self, state: Any, step: int, progress: float) -> tuple[Any, dict[str, Any]]:
        """One update of the trainable values and their moments, and its metrics (see training.method.Method.step).

        progress in [0, 1]: how far down the learning rates are.
        """
        ...

    def remember(self, state: Any) -> Any:
        """The state whose layout knows the cells' optical depths as they are now, by which marches terminate early."""
        ...


def make_engine(name: EngineName, dataset: RayDataset, plan: Plan, settings: Settings, seed: int) -> Engine:
    """The engine of a name; "auto" is JAX's, since only a run that begins may choose (see chosen_engine)."""
    if name != "fused":
        return JaxEngine(dataset, settings, seed)
    problem = _problem_of_fused()
    if problem:
        return _Resting(dataset, settings, seed, problem)
    from training.voxels.fused.engine import FusedEngine  # Numba is heavy, and may be missing

    return FusedEngine(dataset, plan, settings, seed)


def chosen_engine(name: EngineName) -> EngineName:
    """What "auto" means on this machine, for a run that begins: the fused loops on a processor, JAX elsewhere."""
    if name != "auto":
        return name
    problem = _problem_of_fused()
    if problem is None:
        return "fused"
    if jax.default_backend() == "cpu" and jax.device_count() == 1:
        warnings.warn(Notice(f"training would be several times as fast with Numba: {problem[1]}"), stacklevel=2)
    return "jax"


class _Resting(JaxEngine):
    """Stands in for the fused engine where there is none: a run of it is rendered, scored and baked, but not trained."""

    def __init__(self, dataset: RayDataset, settings: Settings, seed: int, problem: tuple[str, str]) -> None:
        super().__init__(dataset, settings, seed)
        self.problem = problem

    def remember(self, state: VoxelState) -> VoxelState:
        found, remedy = self.problem
        raise UserError(
            "this run trains by the fused engine, which cannot be had here", where="--engine fused", found=found,
            remedy=remedy,
        )  # fmt: skip

    def step(self, state: VoxelState, step: int, progress: float) -> tuple[VoxelState, dict[str, Any]]:
        self.remember(state)
        return super().step(state, step, progress)


def _problem_of_fused() -> tuple[str, str] | None:
    """Why the fused engine cannot be had, and what helps."""
    if jax.default_backend() != "cpu":
        return (
            f"JAX has an accelerator, {jax.devices()[0].device_kind}",
            "train on a processor (JAX_PLATFORMS=cpu), or begin another run",
        )
    if jax.device_count() > 1 or jax.process_count() > 1:
        return (
            f"{jax.device_count()} devices that train together",
            "train in one process on one device, or begin another run",
        )
    if importlib.util.find_spec("numba") is None:
        return "Numba is not installed", "pip install 'snerg[train]'"
    return None
