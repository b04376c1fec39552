"""A small occupancy grid of random cells, and rays through it."""

from __future__ import annotations

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np

from training.marching.layout import Cells
from training.method import Rays
from training.multires.jax_engine import cells_of
from training.multires.state import Box

SHAPE = (9, 11, 14)  # z, y, x
ORIGIN, VOXEL = np.array([-0.3, 0.2, 1.0]), 0.1


def random_voxels() -> np.ndarray:
    """bool SHAPE: one voxel in seven is present."""
    return np.random.default_rng(0).random(SHAPE) < 0.15


def cells_of_grid(present: np.ndarray) -> Cells:
    """The occupancy grid, of 16³ cells, whose first ones are `present` bool [z, y, x]."""
    codes = np.zeros((16, 16, 16), np.uint8)
    codes[tuple(slice(n) for n in present.shape)] = present
    box = Box(ORIGIN, np.full(3, VOXEL), np.array(present.shape[::-1], np.int32))
    return cells_of(SimpleNamespace(box=box, codes=codes, step_cells=1.0))  # type: ignore[arg-type]


def random_rays(count: int, seed: int = 0) -> Rays:
    """Rays through the grid, some axis-parallel, some that miss it."""
    rng = np.random.default_rng(seed)
    target = ORIGIN + rng.random((count, 3)) * np.array(SHAPE[::-1]) * VOXEL * 1.3
    origins = target + rng.normal(size=(count, 3))
    directions = target - origins
    directions[: count // 8] = np.eye(3)[rng.integers(0, 3, count // 8)]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    f32 = [jnp.asarray(a, jnp.float32) for a in (origins, directions, directions)]
    return Rays(*f32, jnp.zeros(count), jnp.full(count, 10.0))
