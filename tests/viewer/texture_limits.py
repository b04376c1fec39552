"""A graphics driver that takes smaller textures than the one at hand."""

from math import inf

import pytest

from viewer.rendering import gpu_scene
from viewer.rendering.gpu_scene import NoRoomError


def limit_textures(patch: pytest.MonkeyPatch, largest_side: int = 2048, most_bytes: float = inf) -> None:
    """Packs are refused from now on where a texture has more texels along a side, or more bytes in all."""
    check = gpu_scene.GpuScene._check

    def check_bytes(scene: gpu_scene.GpuScene, what: str, size: int) -> None:
        if size > most_bytes:
            raise NoRoomError(f"the graphics driver has no room for {what}")
        check(scene, what, size)

    patch.setattr(gpu_scene, "largest_texture_side", lambda ctx: largest_side)
    patch.setattr(gpu_scene.GpuScene, "_check", check_bytes)
