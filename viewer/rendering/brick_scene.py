"""A pack's content as bricks in buffers, for software rasterisers; shaders/grid_bricks.glsl says why.

Notation: B = padded block size; S = B rounded up to an even number; H = S / 2. A brick is 2^3 voxels, x fastest, and a
macroblock's H^3 bricks lie one behind the other, x fastest, the macroblocks likewise in the grid's order. A voxel is its rgba
and, in packs that have them, its features: 4 or 8 bytes. With features a brick fills a line of a processor's cache.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from scenepack.pack import Pack
from viewer.rendering.gpu_memory import Uploader
from viewer.rendering.texel_buffer import TexelBuffer

UNITS = {"indirection": 0, "skip_grid": 1, "content": 2}  # texture units
EMPTY = -1
A_STEP = 1 << 20  # bytes of content
SHOWN_EVERY_S = 0.02  # while a pack arrives


def bricks_of(voxels: np.ndarray) -> np.ndarray:
    """uint8 [S^3, c] in the order above, from a macroblock's padded copy, uint8 [B, B, B, c] = [z, y, x, c]."""
    pad = len(voxels) % 2
    if pad:
        voxels = np.pad(voxels, [(0, pad)] * 3 + [(0, 0)])
    half, channels = len(voxels) // 2, voxels.shape[3]
    words = np.ascontiguousarray(voxels).view(f"u{channels}")  # moved whole
    split = words.reshape(half, 2, half, 2, half, 2)
    return split.transpose(0, 2, 4, 1, 3, 5).reshape(-1, 1).view(np.uint8)


class BrickWriter:
    """Lays out a pack's macroblocks as bricks; steps() fills the buffers.

    count: macroblocks. textures: by the name of their sampler. defines: what the shaders must know.
    cubes: the skip grid, see viewer.rendering.skip_grid.cubes_of. near: a point of the grid, in voxels; macroblocks close
    to it arrive first. None: in the grid's order.
    """

    def __init__(self, uploader: Uploader, pack: Pack, features: np.ndarray | None, cubes: np.ndarray) -> None:
        self.pack, self.features = pack, features
        self.near: np.ndarray | None = None
        self.places = pack.atlas_indices[pack.occupied].astype(np.intp) * pack.padded_block_size  # (x, y, z)
        self.count = len(self.places)
        self._arrived = np.zeros(self.count, bool)  # in the grid's order
        side = pack.padded_block_size + pack.padded_block_size % 2
        self.voxels = side**3  # of a macroblock
        self.texel = 8 if features is not None else 4  # bytes
        kind = "rg32ui" if features is not None else "rgba8"
        self.content = uploader.texels("content", self.count * self.voxels, kind, UNITS["content"])
        shape = [n + 2 for n in pack.occupied.shape]
        self.indirection = uploader.texels("indirection", int(np.prod(shape)), "r32i", UNITS["indirection"])
        self.show_arrived()
        skip_grid = uploader.texels("skip distance", cubes.size, "r16ui", UNITS["skip_grid"])
        skip_grid.write(cubes)
        self.textures: dict[str, TexelBuffer] = {
            "indirection": self.indirection,
            "skip_grid": skip_grid,
            "content": self.content,
        }
        self.defines: dict[str, object] = {
            "BRICKS": True,
            "INDIRECTION_SIZE": f"{shape[2]}, {shape[1]}",
            "BYTE": repr(1 / 255),
            "SKIP_SIZE": f"{cubes.shape[2]}, {cubes.shape[1]}",
            **{f"{name.upper()}_UNIT": unit for name, unit in UNITS.items()},
        }

    def show_arrived(self) -> None:
        """Lets rays see the macroblocks that have arrived: the others count as empty, as the border around the grid does."""
        occupied = self.pack.occupied
        first = np.arange(self.count, dtype=np.int32) * self.voxels
        grid = np.full([n + 2 for n in occupied.shape], EMPTY, np.int32)
        grid[1:-1, 1:-1, 1:-1][occupied] = np.where(self._arrived, first, EMPTY)
        self.indirection.write(grid)

    def steps(self) -> Iterator[None]:
        """Fills the content, some macroblocks at a time, and shows them from then on."""
        middles = (np.argwhere(self.pack.occupied)[:, ::-1] + 0.5) * self.pack.block_size
        arrived = self._arrived
        bytes_, shown = self.voxels * self.texel, time.perf_counter()
        at_once = max(1, A_STEP // bytes_)
        while not arrived.all():
            coming = np.flatnonzero(~arrived)
            if self.near is not None:
                away = np.square(middles[coming] - self.near).sum(axis=1)
                coming = coming[np.argsort(away, kind="stable")]
            for slot in np.sort(coming[:at_once]).tolist():
                self.content.write(self._bricks(slot), offset=slot * bytes_)
                arrived[slot] = True
            if time.perf_counter() - shown > SHOWN_EVERY_S or arrived.all():
                self.show_arrived()
                shown = time.perf_counter()
            yield

    def _bricks(self, slot: int) -> np.ndarray:
        x, y, z = self.places[slot].tolist()
        size = self.pack.padded_block_size
        copy = slice(z, z + size), slice(y, y + size), slice(x, x + size)
        voxels = self.pack.atlas_rgba[copy]
        if self.features is not None:
            voxels = np.concatenate([voxels, self.features[copy]], axis=-1)
        return bricks_of(voxels)
