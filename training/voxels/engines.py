"""Which engine a run has: training.voxels.engine.Engine by name, and the choice where a run begins."""

from __future__ import annotations

import importlib
import importlib.util
import warnings
from typing import Any

import jax

from console import Notice, UserError
from training.config import EngineName
from training.dataset import RayDataset
from training.voxels.engine import Engine
from training.voxels.jax_engine import JaxEngine
from training.voxels.settings import Plan, Settings
from training.voxels.state import VoxelState


def make_engine(name: EngineName, dataset: RayDataset, plan: Plan, settings: Settings, seed: int) -> Engine:
    """The engine of a name; "auto" is JAX's, since only a run that begins may choose (see chosen_engine)."""
    if name != "fused":
        return JaxEngine(dataset, plan, settings, seed)
    problem = _problem_of_fused()
    if problem:
        return _Resting(dataset, plan, settings, seed, problem)
    fused = importlib.import_module("training.voxels.fused.engine")  # Numba is heavy, and may be missing
    return fused.FusedEngine(dataset, plan, settings, seed)


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

    def __init__(
        self, dataset: RayDataset, plan: Plan, settings: Settings, seed: int, problem: tuple[str, str]
    ) -> None:
        super().__init__(dataset, plan, settings, seed)
        self.problem = problem

    def begin(self, state: VoxelState) -> VoxelState:
        return state  # as it is: no step is ever made of it

    def end(self, state: VoxelState) -> VoxelState:
        return state

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
