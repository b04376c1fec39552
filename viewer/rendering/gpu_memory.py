"""What a graphics card has room for, and textures made there one checked allocation at a time."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

import moderngl
import numpy as np

from console import UserError

if TYPE_CHECKING:
    from viewer.rendering.texture_preallocation import PreallocatedTexture

OR_HALF = "or measure it at half resolution: --allow-half"  # the remedy of commands that have this option


class NoRoomError(UserError):
    """A pack does not fit on the graphics card."""


@dataclass(frozen=True)
class Limits:
    """What a card takes. max_side: voxels a side of a 3D texture. max_texture_bytes: of one texture."""

    max_side: int
    max_texture_bytes: float = inf

    @classmethod
    def of(cls, ctx: moderngl.Context) -> Limits:
        """What the driver says. It tells no number of bytes; those it refuses when they are asked for."""
        return cls(ctx.info["GL_MAX_3D_TEXTURE_SIZE"])


class Uploader:
    """Creates textures and counts their bytes; every allocation is checked, for moderngl does not.

    preallocated: a texture made ahead, used where its size fits.
    """

    def __init__(
        self, ctx: moderngl.Context, limits: Limits | None = None, preallocated: PreallocatedTexture | None = None
    ) -> None:
        self.ctx, self.bytes, self.limits, self.preallocated = ctx, 0, limits or Limits.of(ctx), preallocated
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
        texture = self.preallocated.take(size, channels) if self.preallocated is not None and dtype == "f1" else None
        texture = texture or self.ctx.texture3d(size, channels, alignment=1, dtype=dtype)
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
