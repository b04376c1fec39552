"""The state of the field: plain arrays, whichever engine makes its steps."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np


class Box(NamedTuple):
    """Where the unit cube is. origin float64 [3]: its low corner in the training frame. cell float64 [3]: sides of a cell of the
    occupancy grid, in world units. dims int32 [3] = (x, y, z): cells that the scene's box fills; beyond them nothing is.
    """

    origin: np.ndarray
    cell: np.ndarray
    dims: np.ndarray


class Trainable(NamedTuple):
    """table [E, 4]: features by row (training.multires.levels). parameters [P]: of decoder and view MLP
    (training.multires.field). Values, or Adam's moments of them."""

    table: Any
    parameters: Any


@dataclass
class State:
    """All that changes between steps, and where the field lies.

    box: see Box. bricks: of each level, int32, the bricks present; None where it has not joined. values, first, second: what is
    trained, and its moments. codes uint8 [R, R, R]: see training.multires.occupancy. updates: steps made. samples_per_ray: of
    late. step_cells: distance between samples, in cells of the occupancy grid. gains float32 [V, 3]: of the photographs
    (training.exposure), or None.
    """

    box: Box
    bricks: tuple[np.ndarray | None, ...]
    values: Trainable
    first: Trainable
    second: Trainable
    codes: np.ndarray
    updates: int
    samples_per_ray: float
    step_cells: float
    gains: np.ndarray | None = None
    kept: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)  # by an engine: derived, never saved
