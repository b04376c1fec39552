"""The interface of a training engine: what computes the steps of the field, and evaluates it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from training.method import Rays, RenderOutput
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

    def parts(self, state: State, step: int, progress: float) -> Iterator[tuple[str, Any]]:
        """`step` part by part: after each, its name and what it leaves. The last is ("adam", metrics)."""
        ...

    def values_at(self, state: State, points: np.ndarray) -> np.ndarray:
        """float32 [N, 8] at points float32 [N, 3] of the unit cube: density per side of the cube, colours, features."""
        ...

    def render(self, state: State, rays: Rays) -> RenderOutput:
        """See training.method.Method.render."""
        ...
