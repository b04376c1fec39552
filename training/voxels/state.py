"""The state of the fast method: plain arrays, whichever engine makes its steps (training.voxels.engine)."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from training.marching.march import MarchSizes
from training.method import ViewMlpParams
from training.voxels.sparse_grid import GridLayout


class Trainable(NamedTuple):
    """rows [V + 1, 8] raw values, and the view MLP (None: diffuse)."""

    rows: jax.Array
    head: ViewMlpParams | None


class Optimised(NamedTuple):
    """All that a step changes: the trainable values, Adam's moments of these, and how many updates there were, int32."""

    trainable: Trainable
    first: Trainable
    second: Trainable
    updates: jax.Array


class Stage(NamedTuple):
    """What stays the same until voxels are pruned or refined, but for the optical depths that the layout remembers.

    cells int32 [V + 1]: padded voxel of each row. hits int [rays]: ids of the training rays that meet content, of which
    the first hit_count hold; the rest is padding that the JAX engine needs. Where every ray is meant, hits is empty, since a list
    of billions would take more memory than all else: see ray_ids.
    """

    layout: GridLayout
    cells: jax.Array
    hits: jax.Array
    hit_count: jax.Array


def ray_ids(hits: Any, places: Any) -> Any:
    """Ids of the rays at `places` int [N], below hit_count, of a stage's hits; arrays of NumPy or of JAX."""
    return hits[places] if hits.shape[0] else places


class VoxelState(NamedTuple):
    """All that changes between steps: the fields of Optimised and of Stage.

    sizes, rays: how long the JAX engine's lists of a step are, and how many rays fill a step; plain numbers. sizes is None, and
    rays 0, where no engine has looked yet. step_voxels: distance between samples, in voxels, a plain number as well.
    closed: whether holes have been closed (training.voxels.holes). gains float32 [V, 3]: of the photographs (training.exposure);
    None where they are taken as they are.
    """

    trainable: Trainable
    first: Trainable
    second: Trainable
    updates: jax.Array
    layout: GridLayout
    cells: jax.Array
    hits: jax.Array
    hit_count: jax.Array
    sizes: MarchSizes | None
    rays: int
    step_voxels: float
    closed: bool = False
    gains: Any = None

    @property
    def optimised(self) -> Optimised:
        return Optimised(self.trainable, self.first, self.second, self.updates)

    @property
    def stage(self) -> Stage:
        return Stage(self.layout, self.cells, self.hits, self.hit_count)

    def after(self, step: Optimised) -> VoxelState:
        """The state with what a step has changed."""
        return self._replace(**step._asdict())


def state_over(
    layout: GridLayout, parts: tuple[Trainable, Trainable, Trainable], updates: jax.Array, rays: int,
    step_voxels: float = 1.0, gains: Any = None,
) -> VoxelState:  # fmt: skip
    """A state that no engine has looked at yet, which draws from all of so many rays. parts: values and their two moments."""
    (cells,) = np.nonzero(np.asarray(layout.lookup))
    return VoxelState(
        *parts, updates=updates, layout=layout, cells=jnp.asarray(np.concatenate([[0], cells]).astype(np.int32)),
        hits=jnp.zeros(0, jnp.int32), hit_count=jnp.int32(rays), sizes=None, rays=0, step_voxels=step_voxels,
        gains=gains,
    )  # fmt: skip
