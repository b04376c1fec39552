"""Batches of many rays: which of them meet content, and all of them marched whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from training.marching.layout import Layout
from training.marching.march import occupied_segments
from training.marching.rays import RaySource, to_grid

LOOKED_AT = 16_384  # rays at once where only coarse occupancy is asked
Output = TypeVar("Output")


@partial(jax.jit, static_argnames=("segments", "phase", "step"))
def _meets(
    layout: Layout, source: RaySource, ids: jax.Array, away: jax.Array | None, segments: int, phase: float, step: float
) -> jax.Array:
    rays = to_grid(layout, source.geometry_at(ids, away))
    return occupied_segments(layout, rays, jnp.full(ids.shape[0], phase), segments, step).any(-1)


def rays_that_meet(
    layout: Layout,
    source: RaySource,
    ids: np.ndarray,
    segments: int,
    *,
    away: np.ndarray | None = None,
    phase: float = 0.5,
    step: float = 1.0,
) -> np.ndarray:
    """bool [N]: which of the rays int32 ids [N] of a source, in the layout's frame, may meet content.

    away: [N, 2] pixels from the centres of their pixels. phase, step: as they will be marched, see march.
    """
    meets = np.zeros(-(-len(ids) // LOOKED_AT) * LOOKED_AT, bool)
    for start in range(0, len(ids), LOOKED_AT):
        chosen = _from(start, LOOKED_AT, len(ids))
        places = None if away is None else jnp.asarray(away[chosen])
        meets[start : start + LOOKED_AT] = _meets(
            layout, source, jnp.asarray(ids[chosen]), places, segments, phase, step
        )
    return meets[: len(ids)]


def until_complete(
    count: int, size: int, march_some: Callable[[np.ndarray], tuple[Output, jax.Array]]
) -> Iterator[tuple[int, int, Output]]:
    """Marches `count` rays, `size` at a time, each until it is whole: (first, one past the last, output) of what is done.

    march_some: places int [size] among the rays, in order and filled up with the last -> its output, and bool [size]: which
    of them were marched whole (Samples.complete). What follows the first that was not is marched again.
    """
    start = 0
    while start < count:
        output, complete = march_some(_from(start, size, count))
        whole = np.asarray(complete)
        ready = size if whole.all() else max(int(whole.argmin()), 1)  # a ray that never fits is passed over
        end = min(start + ready, count)
        yield start, end, output
        start = end


def _from(start: int, size: int, count: int) -> np.ndarray:
    return np.minimum(np.arange(start, start + size), count - 1)
