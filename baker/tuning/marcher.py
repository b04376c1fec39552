"""What the baker asks of many training rays through a pack, marched as the viewer marches it; and who answers.

Rays are told by ids int32 [N] of pixels and `away` float32 [N, 2], in pixels from their centres (None: none).
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from scenepack.pack import Pack
from training.dataset import RayDataset
from training.marching.rays import GridFrameRays

OnShare = Callable[[float], None]


class Accumulated(NamedTuple):
    """What the march leaves of N rays: colour [N, 3] and features [N, 4], premultiplied; T [N] behind the last sample.
    Of NumPy or of JAX."""

    colour: jax.Array
    features: jax.Array
    transmittance: jax.Array


class Box(NamedTuple):
    """A pack's grid in its frame, as training.marching.rays.to_grid asks for it: origin [3], voxel, dims int32 [3]."""

    origin: jax.Array
    voxel: jax.Array
    dims: jax.Array


class PackMarcher(Protocol):
    """rays: the training rays in the pack's frame. box: its grid there. What a marcher has of the pack must stay as it is."""

    rays: GridFrameRays
    box: Box

    def meets(self, ids: np.ndarray, away: np.ndarray | None = None) -> np.ndarray:
        """bool [N]: which rays may meet content; False only where none does."""
        ...

    def half_depths(self, ids: np.ndarray) -> np.ndarray:
        """float32 [N]: distance along each ray, in voxels, of the last sample that half of the light or more arrives at; 0
        where there is none."""
        ...

    def light(self, ids: np.ndarray, away: np.ndarray, on_share: OnShare | None = None) -> np.ndarray:
        """uint8 [slots, B, B, B] of the occupied macroblocks' padded copies, in the grid's order: the largest T before a
        sample that a voxel is part of, in units of 1/255 and rounded up; 0 where there is none."""
        ...

    def accumulate(self, ids: np.ndarray, on_share: OnShare | None = None) -> Accumulated:
        """What the viewer accumulates along each ray (docs/rendering.md)."""
        ...


def box_of(pack: Pack) -> Box:
    """The box of a pack's grid."""
    dims = jnp.asarray(pack.grid_size, jnp.int32)
    return Box(jnp.asarray(pack.min_xyz, jnp.float32), jnp.float32(pack.voxel_size), dims)


def compiled_loops() -> bool:
    """Whether packs are marched by compiled loops: on a processor, where Numba is."""
    return jax.default_backend() == "cpu" and importlib.util.find_spec("numba") is not None


def make_marcher(pack: Pack, dataset: RayDataset) -> PackMarcher:
    """By compiled loops where they are, and by JAX elsewhere; however many devices or processes bake."""
    # Imported when they are asked for: Numba is heavy, and may be missing.
    name = "fused.marcher" if compiled_loops() else "jax_marcher"
    return importlib.import_module(f"baker.tuning.{name}").marcher_of(pack, dataset)
