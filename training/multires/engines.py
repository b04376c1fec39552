"""Training engines: what computes the steps of the field and evaluates it; their interface, and which one a run has."""

from __future__ import annotations

import importlib
from typing import Any, Protocol

import jax
import numpy as np

from console import UserError
from training.config import EngineName
from training.dataset import RayDataset
from training.method import Rays, RenderOutput
from training.multires.jax_engine import JaxEngine
from training.multires.settings import Plan, Settings
from training.multires.state import State


class Engine(Protocol):
    """Agrees with training.multires.field to rounding. What is random about a step comes from the seed and the step alone; two
    engines may draw differently. An engine may keep what it derives from a state in state.kept.
    """

    def adopt(self, state: State) -> State:
        """The state with arrays as the engine needs them."""
        ...

    def step(self, state: State, step: int, progress: float) -> dict[str, Any]:
        """One update of the state, in place, and its metrics (see training.method.Method.step)."""
        ...

    def values_at(self, state: State, points: np.ndarray) -> np.ndarray:
        """float32 [N, 8] at points float32 [N, 3] of the unit cube: density per side of the cube, colours, features."""
        ...

    def render(self, state: State, rays: Rays) -> RenderOutput:
        """See training.method.Method.render."""
        ...


def make_engine(name: EngineName, dataset: RayDataset, plan: Plan, settings: Settings, seed: int) -> Engine:
    """The engine of a name; where the fused one cannot be had, one that renders its runs but does not train them."""
    if name == "jax":
        return JaxEngine(dataset, plan, settings, seed)
    problem = _problem_of_fused()
    if problem is not None:
        return _RenderingEngine(dataset, plan, settings, seed, problem)
    fused = importlib.import_module("training.multires.fused.engine")  # compiles as it is imported
    return fused.FusedEngine(dataset, plan, settings, seed)


def chosen_engine(name: EngineName) -> EngineName:
    """What "auto" means on this machine, for a run that begins: the fused loops on a processor, JAX elsewhere."""
    if name != "auto":
        return name
    return "fused" if _problem_of_fused() is None else "jax"


class _RenderingEngine(JaxEngine):
    """Stands in for the fused engine where there is none: a run of it is rendered, scored and baked, but not trained."""

    def __init__(
        self, dataset: RayDataset, plan: Plan, settings: Settings, seed: int, problem: tuple[str, str]
    ) -> None:
        super().__init__(dataset, plan, settings, seed)
        self.problem = problem

    def step(self, state: State, step: int, progress: float) -> dict[str, Any]:
        found, remedy = self.problem
        raise UserError(
            "this run trains by the fused engine, which cannot be had here", where="--engine fused", found=found,
            remedy=remedy,
        )  # fmt: skip


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
    return None
