"""GPU memory: limits, uploads in pieces, and packs halved to fit.

Notation: each voxel of the half pack stands for 2^3 voxels of the whole one, the last of an odd side for those it has.
Its premultiplied colour, features and opacity a are their mean. A ray takes half as many samples there, each of which
must do the work of two, one behind the other: c + (1 - a) c and a + (1 - a) a, both 2 - a times the mean. The block size
stays, so that the padding, which is made anew from the neighbours, takes no greater share.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from math import inf

import moderngl
import numpy as np

from console import UserError
from scenepack.blocks import atlas_from_volume, block_copy, grid_block_counts
from scenepack.pack import Pack

OR_HALF = "or measure it at half resolution: --allow-half"  # the remedy of commands that have this option


class NoRoomError(UserError):
    """A pack does not fit on the graphics card."""


@dataclass(frozen=True)
class Limits:
    """What a GPU takes. max_side: voxels a side of a 3D texture. max_texture_bytes: of one texture."""

    max_side: int
    max_texture_bytes: float = inf

    @classmethod
    def of(cls, ctx: moderngl.Context) -> Limits:
        """What the driver says. It tells no number of bytes; those it refuses when they are asked for."""
        return cls(ctx.info["GL_MAX_3D_TEXTURE_SIZE"])


class Uploader:
    """Creates textures, counts their bytes and checks every allocation."""

    def __init__(self, ctx: moderngl.Context, limits: Limits | None = None) -> None:
        self.ctx, self.bytes, self.limits = ctx, 0, limits or Limits.of(ctx)
        self.made: list[moderngl.Texture | moderngl.Texture3D] = []
        while ctx.error != "GL_NO_ERROR":  # somebody else's, from before
            pass

    def check(self, what: str, size: int) -> None:
        error = self.ctx.error
        if error != "GL_NO_ERROR":
            raise NoRoomError(
                f"the graphics driver has no room for {what}",
                expected=f"{size / 2**20:.0f} MiB of texture memory",
                found=error,
                remedy="close other programs, or bake at a lower resolution",
            )

    def _refuse_more_than_fits(self, what: str, bytes_: int) -> None:
        if bytes_ > self.limits.max_texture_bytes:
            raise NoRoomError(
                f"the {what} texture is too large for this graphics driver",
                expected=f"at most {self.limits.max_texture_bytes / 2**20:.0f} MiB",
                found=f"{bytes_ / 2**20:.0f} MiB",
                remedy="bake at a lower resolution",
            )

    def volume(self, what: str, size: tuple[int, int, int], channels: int, dtype: str = "f1") -> moderngl.Texture3D:
        """An uninitialised 3D texture of size (x, y, z)."""
        bytes_ = int(np.prod(size, dtype=np.int64)) * channels * int(dtype[-1])
        self._refuse_more_than_fits(what, bytes_)
        texture = self.ctx.texture3d(size, channels, alignment=1, dtype=dtype)
        self.made.append(texture)
        self.check(f"the {what} texture", bytes_)
        self.bytes += bytes_
        return texture

    def filled(self, what: str, data: np.ndarray, dtype: str = "u1") -> moderngl.Texture3D:
        """A 3D texture from data [z, y, x, channels]."""
        z, y, x, channels = data.shape
        texture = self.volume(what, (x, y, z), channels, dtype)
        texture.write(np.ascontiguousarray(data), alignment=1)
        return texture

    def weights(self, matrix: np.ndarray) -> moderngl.Texture:
        """weights [inputs, outputs] as float RGBA texels, outputs padded to whole texels."""
        inputs, outputs = matrix.shape
        padded = np.zeros((inputs, -(-outputs // 4) * 4), np.float32)
        padded[:, :outputs] = matrix
        texture = self.ctx.texture((padded.shape[1] // 4, inputs), 4, padded.tobytes(), dtype="f4")
        self.made.append(texture)
        self.check("the view MLP's weights", padded.nbytes)
        self.bytes += padded.nbytes
        return texture

    def give_up(self) -> None:
        """Frees what was made so far."""
        for texture in self.made:
            texture.release()


# --- A pack at half its resolution ---

Triple = tuple[int, int, int]


def half_resolution(pack: Pack) -> Pack:
    """`pack` with voxels of twice the side, in the same place; the grid's far faces may lie one old voxel farther out."""
    x, y, z = (-(-side // 2) for side in pack.grid_size)
    grid_size = (x, y, z)
    occupied = np.zeros(grid_block_counts(grid_size, pack.block_size)[::-1], bool)
    bz, by, bx = np.nonzero(pack.occupied)
    occupied[bz // 2, by // 2, bx // 2] = True  # along each axis, macroblocks 2 i and 2 i + 1 make the new one i

    def read_box(low: Triple, high: Triple) -> tuple[np.ndarray, np.ndarray | None]:
        rgba = _means(pack, pack.atlas_rgba, low, high)
        gain = 2.0 - rgba[..., 3:] / 255.0
        if pack.atlas_features is None:
            return _quantised(rgba * gain), None
        return _quantised(rgba * gain), _quantised(_means(pack, pack.atlas_features, low, high) * gain)

    indices, rgba, features = atlas_from_volume(read_box, grid_size, pack.block_size, occupied)
    if pack.atlas_features is not None and features is None:
        features = np.zeros_like(rgba)
    return replace(
        pack,
        voxel_size=2.0 * pack.voxel_size,
        grid_size=grid_size,
        atlas_indices=indices,
        atlas_rgba=rgba,
        atlas_features=features,
    )


def _quantised(values: np.ndarray) -> np.ndarray:
    return np.rint(np.minimum(values, 255.0)).astype(np.uint8)


def _means(pack: Pack, atlas: np.ndarray, low: Triple, high: Triple) -> np.ndarray:
    """float32 [z, y, x, c], 0 … 255: means of 2^3 voxels, for the half pack's voxels `low` to `high` (z, y, x)."""
    start = [2 * n for n in low]
    voxels = np.zeros((*(2 * (hi - lo) for lo, hi in zip(low, high, strict=True)), atlas.shape[3]), np.uint8)
    stop = [min(s + n, side) for s, n, side in zip(start, voxels.shape, pack.grid_size[::-1], strict=False)]
    size = pack.block_size
    occupied = pack.occupied
    for block in product(*(range(s // size, -(-e // size)) for s, e in zip(start, stop, strict=True))):
        if not occupied[block]:
            continue
        first = [max(i * size, s) for i, s in zip(block, start, strict=True)]
        last = [min((i + 1) * size, e) for i, e in zip(block, stop, strict=True)]
        to = tuple(slice(a - s, b - s) for a, b, s in zip(first, last, start, strict=True))
        of = tuple(slice(a - i * size + 1, b - i * size + 1) for a, b, i in zip(first, last, block, strict=True))
        voxels[to] = block_copy(pack, atlas, block)[of]
    z, y, x, channels = voxels.shape
    pairs = voxels.reshape(z // 2, 2, y // 2, 2, x // 2, 2, channels)
    return pairs.mean(axis=(1, 3, 5), dtype=np.float32)
