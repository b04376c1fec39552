"""The content of kept macroblocks: samples within each voxel, averaged and quantised (SNeRG sections 5.3 and 5.4).

The paper takes 16 Gaussian samples a voxel, since an MLP may change within a voxel by as much as it likes. The multi-resolution
field is smooth within the cells of its finest level (its grain), and blurring it again loses sharpness. So it is sampled once for
each of its cells within a voxel. Colours and features are weighted by opacity before they are averaged. With `as_paper`, all is
what the paper writes: 16 Gaussian samples always, and plain averages of colours, features and densities.

Macroblocks are made some at a time, in z, y, x order, and kept on disk where a work folder is given; of each only the
voxels that are not empty. The random numbers of a macroblock depend on the seed and its place alone.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from baker.baking.culling import Culling
from baker.baking.field_query import BATCH, FieldQuery
from baker.baking.grid import BakeGrid
from baker.baking.work_folder import Arrays, Tick, WorkFolder, in_order

SAMPLES = 16
SIGMA = np.float32(1 / np.sqrt(12))  # of the Gaussian, in voxels: a voxel's own standard deviation
MOST_ALONG = 3  # samples along an axis of a voxel, of a field with a grain
# NumPy and compiled loops let go of Python's lock; each thread may hold a batch of a network's activations.
THREADS = min(os.cpu_count() or 1, 4)
BLOCKS_AT_ONCE = 32  # macroblocks to a piece of work: about a second of it on two cores


def supersample(
    sampler: Sampler, tick: Tick = lambda share: None, work: WorkFolder | None = None
) -> Iterator[tuple[tuple[int, ...], np.ndarray]]:
    """(place z, y, x; uint8 [block_size³ as z, y, x, 8]) of the kept macroblocks: rgb and alpha, premultiplied, features.

    Voxels far from any opacity stay zero without being asked. tick: called with the share that is done.
    """
    size, parts = sampler.grid.block_size, _parts(sampler)

    def make(part: np.ndarray, _: Tick) -> Arrays:
        places, values = sampler.content(part, pool)
        values = np.round(255 * values).astype(np.uint8)
        values[values[:, 3] == 0] = 0
        some = values.any(axis=1)
        return {"places": places[some], "values": values[some]}

    with ThreadPoolExecutor(THREADS) as pool:
        pieces = [(f"voxels_{BLOCKS_AT_ONCE * i:06d}", partial(make, part)) for i, part in enumerate(parts)]
        for part, made in zip(parts, in_order(work, pieces, tick), strict=True):
            voxels = np.zeros((len(part), size, size, size, 8), np.uint8)
            voxels.reshape(-1, 8)[made["places"]] = made["values"]
            yield from zip(map(tuple, part.tolist()), voxels, strict=True)


def supersample_floats(sampler: Sampler, tick: Tick) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The same content before it is quantised: macroblocks [n, 3] (z, y, x), places and content as Sampler.content gives them."""
    parts = _parts(sampler)
    with ThreadPoolExecutor(THREADS) as pool:
        for i, part in enumerate(parts):
            yield part, *sampler.content(part, pool)
            tick((i + 1) / len(parts))


def _parts(sampler: Sampler) -> list[np.ndarray]:
    """The kept macroblocks int [n, 3] (z, y, x), BLOCKS_AT_ONCE or fewer in each part."""
    blocks = np.argwhere(sampler.culling.kept)
    return np.split(blocks, range(BLOCKS_AT_ONCE, len(blocks), BLOCKS_AT_ONCE))


@dataclass(frozen=True)
class Sampler:
    """Averages a field of this grain (training.method.Method.grain) within the voxels of a grid. as_paper: see above."""

    query: FieldQuery
    grid: BakeGrid
    culling: Culling
    grain: np.ndarray | None = None
    seed: int = 0
    as_paper: bool = False

    @cached_property
    def lattice(self) -> np.ndarray | None:
        """float32 [S, 3], x, y, z in voxels from a voxel's centre: where the field is sampled; None for Gaussian samples."""
        if self.as_paper or self.grain is None:
            return None
        own = np.abs(self.grid.worldspace_T_opengl[:3, :3]).T @ self.grain / self.grid.voxel_size
        counts = np.clip(np.round(1 / np.maximum(own, 1e-6)), 1, MOST_ALONG).astype(int)
        axes = [(np.arange(n, dtype=np.float32) + 0.5) / n - 0.5 for n in counts]
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)

    def content(self, blocks: np.ndarray, pool: Executor) -> tuple[np.ndarray, np.ndarray]:
        """Flat places int32 [N] among the voxels of `blocks` [n, 3], one after another, and their content float32 [N, 8]:
        premultiplied rgb, alpha and features, not quantised."""

        at_once = max(BATCH // (SAMPLES if self.lattice is None else len(self.lattice)), 1)  # voxels of a thread

        def fill(start: int) -> None:
            part = slice(start, start + at_once)
            values[part] = self._average(centres[part, None] + offsets[part])

        places, voxels = zip(*pool.map(lambda i: self._wanted(i, blocks[i]), range(len(blocks))), strict=True)
        centres = np.concatenate(voxels) + np.float32(0.5)
        if self.lattice is None:
            offsets = np.concatenate(list(pool.map(self._noise, blocks, map(len, voxels))))
        else:
            offsets = np.broadcast_to(self.lattice, (len(centres), *self.lattice.shape))
        values = np.empty((len(centres), 8), np.float32)
        list(pool.map(fill, range(0, len(centres), at_once)))
        return np.concatenate(places), values

    def _noise(self, block: np.ndarray, count: int) -> np.ndarray:
        """float32 [count, SAMPLES, 3]: Gaussian offsets within the voxels of a macroblock."""
        return SIGMA * np.random.default_rng((self.seed, *block)).standard_normal((count, SAMPLES, 3), np.float32)

    def _wanted(self, number: int, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of a macroblock's voxels in wanted cells: flat places int32 [N], counted from `number` macroblocks on; positions
        float32 [N, 3], in voxels."""
        size, cell = self.grid.block_size, self.grid.cell
        per_block = size // cell
        cells = self.culling.cells[tuple(slice(b * per_block, (b + 1) * per_block) for b in block)]
        wanted = np.repeat(np.repeat(np.repeat(cells, cell, 0), cell, 1), cell, 2)
        z, y, x = np.nonzero(wanted)
        places = (number * size**3 + np.flatnonzero(wanted)).astype(np.int32)
        return places, (np.stack([x, y, z], -1) + block[::-1] * size).astype(np.float32)

    def _average(self, positions: np.ndarray) -> np.ndarray:
        """float32 [N, 8], premultiplied rgb, alpha and features, averaged over positions [N, samples, 3] in voxels.

        Colours are weighted by opacity before they are averaged, so that what is transparent does not tint what is not.
        """
        count, size = positions.shape[:2], np.float32(self.grid.voxel_size)
        field = self.query(self.grid.training_points(positions.reshape(-1, 3)))
        density = np.asarray(field.density, np.float32).reshape(count)
        diffuse, features = (np.asarray(a, np.float32).reshape(*count, -1) for a in (field.diffuse, field.features))
        if self.as_paper:
            density, diffuse, features = (values.mean(1, keepdims=True) for values in (density, diffuse, features))
        alpha = -np.expm1(-density * size)
        values = np.empty((*alpha.shape, 8), np.float32)
        np.multiply(diffuse, alpha[..., None], out=values[..., :3])
        values[..., 3] = alpha
        np.multiply(features, alpha[..., None], out=values[..., 4:])
        return values.mean(1)
