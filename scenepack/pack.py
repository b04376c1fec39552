"""Pack: a baked scene in memory (docs/format.md).

Volumes are [z, y, x, c]; a "block" is a macroblock; B = block_size + 2 is its side in the atlas, padding
included.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import Any, TypeVar

import numpy as np

from console import Notice
from scenepack.constants import EMPTY_BLOCK

MOST_LENGTH = 1e6  # grid units; a larger number in the metadata is nonsense


def number_in(value: Any, low: float, high: float) -> float | None:
    """A value of JSON as a number; None where it is none, or not one of low … high."""
    fits = isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high
    return float(value) if fits else None


def number_array(value: Any, dtype: type = np.float64) -> np.ndarray | None:
    """Nested lists of JSON's numbers as an array; None where they are ragged, or hold anything else, such as true."""
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    if any(isinstance(one, bool) for one in np.asarray(value, object).flat):  # among numbers, NumPy makes 1 of it
        return None
    with np.errstate(over="ignore"):
        return array.astype(dtype) if array.dtype.kind in "iuf" else None


@dataclass(frozen=True)
class ViewMlp:
    """The view MLP: float32 weights [34, 16], [16, 16], [16, 3] (input-major) and biases [16], [16], [3]."""

    weights: tuple[np.ndarray, np.ndarray, np.ndarray]
    biases: tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Pack:
    """One baked scene. Arrays are treated as read-only."""

    voxel_size: float  # world units
    min_xyz: np.ndarray  # world position of the grid's corner, in the OpenGL grid frame (y up)
    grid_size: tuple[int, int, int]  # voxels (width, height, depth) = (x, y, z)
    block_size: int  # data voxels per macroblock side (B - 2)
    atlas_indices: np.ndarray  # uint8 [blocks z, y, x, 3], a macroblock's atlas block (x, y, z); 255 = empty
    atlas_rgba: np.ndarray  # uint8 [D, H, W, 4], rgb premultiplied by alpha
    atlas_features: np.ndarray | None  # uint8 [D, H, W, 4]
    view_mlp: ViewMlp | None  # None for a diffuse pack
    worldspace_T_opengl: np.ndarray  # float64 [4, 4], grid frame to training frame
    ndc: bool = False  # forward-facing pack; then the next three, in pixels, are set
    input_width: float | None = None
    input_height: float | None = None
    input_focal: float | None = None
    params: Mapping[str, Any] = field(default_factory=dict)  # scene_params.json as read, from which the writer starts

    @property
    def atlases(self) -> list[np.ndarray]:
        """atlas_rgba, and atlas_features where there are any."""
        return [self.atlas_rgba] if self.atlas_features is None else [self.atlas_rgba, self.atlas_features]

    @property
    def padded_block_size(self) -> int:
        """B: voxels per macroblock side in the atlas."""
        return self.block_size + 2

    @property
    def grid_blocks(self) -> tuple[int, int, int]:
        """Macroblocks of the grid along (x, y, z)."""
        return self.atlas_indices.shape[2], self.atlas_indices.shape[1], self.atlas_indices.shape[0]

    @property
    def atlas_blocks(self) -> tuple[int, int, int]:
        """Macroblocks that fit in the atlas along (x, y, z), from the atlas's real size."""
        depth, height, width = self.atlas_rgba.shape[:3]
        size = self.padded_block_size
        return width // size, height // size, depth // size

    @property
    def occupied(self) -> np.ndarray:
        """bool [blocks z, blocks y, blocks x]: macroblocks that hold content."""
        return self.atlas_indices[..., 0] != EMPTY_BLOCK

    @property
    def metadata(self) -> Mapping[str, Any]:
        """Our own additional keys (docs/format.md, "Additional keys"): version, codec, cameras, provenance."""
        entries = self.params.get("snerg")
        return entries if isinstance(entries, Mapping) else {}

    @property
    def near(self) -> float:
        """How far from the cameras of its photographs rays begin, grid units; 0 where the pack does not say, or says nonsense."""
        return number_in(self.metadata.get("near"), 0, MOST_LENGTH) or 0.0

    @property
    def contraction(self) -> float | None:
        """R, half the side of the inner cube of a contracted pack (scenepack.contraction), grid units; None for packs of straight
        space: forward-facing ones, and those that do not say, or say nonsense."""
        return None if self.ndc else number_in(self.metadata.get("contraction"), self.voxel_size, MOST_LENGTH)

    @property
    def max_xyz(self) -> np.ndarray:
        """World position of the grid's far corner."""
        return self.min_xyz + self.voxel_size * np.asarray(self.grid_size)

    def with_metadata(self, **entries: Any) -> Pack:
        """A copy whose "snerg" key has `entries` added."""
        return replace(self, params={**self.params, "snerg": {**self.metadata, **entries}})


# --- Pack cache: per-pack memoisation. The thread that reads a pack computes first, so that no window waits ---

T = TypeVar("T")


def cached_per_pack(compute: Callable[[Pack], T]) -> Callable[[Pack], T]:
    """Decorator: keeps the result of `compute` with the pack."""
    name = f"_{compute.__module__}.{compute.__qualname__}"  # beside its fields, which copies do not take along

    @wraps(compute)
    def cached(pack: Pack) -> T:
        if name not in pack.__dict__:
            pack.__dict__[name] = compute(pack)
        return pack.__dict__[name]

    return cached


# --- Warnings about what the reader repairs in untidy packs (docs/format.md, "Untidy packs") ---


class PackWarning(Notice):
    """An untidy pack was opened all the same; the message says what was repaired or left out."""
