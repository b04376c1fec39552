"""What is uploaded: little more than the content, in textures that the driver really made."""

from __future__ import annotations

from collections.abc import Callable

import moderngl
import numpy as np
import pytest

from console import UserError
from scenepack.pack import Pack
from tests.scenepack.random_packs import random_pack
from viewer.rendering.gpu_scene import GpuScene, Limits, _Uploader, tightest_atlas, upload
from viewer.rendering.offscreen import OffscreenRenderer


def atlas_of(scene: GpuScene, name: str) -> np.ndarray:
    texture = scene.textures[name]
    x, y, z = scene.atlas_size
    return np.frombuffer(texture.read(alignment=1), np.uint8).reshape(z, y, x, -1)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 63, 64, 65, 455, 753, 4000, 4097, 5003, 62_000])
@pytest.mark.parametrize("max_side", [1024, 2048])
def test_the_atlas_has_room_for_all_blocks_and_next_to_no_more(count: int, max_side: int) -> None:
    if count > (max_side // 32) ** 3:
        with pytest.raises(UserError, match="too large"):
            tightest_atlas(count, 32, max_side)
        return
    slots = tightest_atlas(count, 32, max_side)
    assert count <= np.prod(slots) <= max(1.02 * count, count + 1) and max(slots) * 32 <= max_side


@pytest.mark.parametrize("layout", ["one", "two", "paper"])
def test_every_macroblock_arrives_unchanged(ctx: moderngl.Context, layout: str) -> None:
    """In one atlas, in two where a texture of twice the size is refused, and in the paper's."""
    pack = random_pack(np.random.default_rng(5), block_size=14, grid_blocks=(3, 3, 2), occupancy=0.02, style="noise")
    room = int(pack.occupied.sum()) * pack.padded_block_size**3 * 4
    limits = Limits(2048, 1.5 * room) if layout == "two" else None
    scene = upload(ctx, pack, "paper" if layout == "paper" else "exact", limits)
    indirection = np.frombuffer(scene.textures["indirection"].read(alignment=1), np.uint8)
    indirection = indirection.reshape(*(n + 2 for n in pack.occupied.shape), 4)
    assert np.array_equal(indirection[1:-1, 1:-1, 1:-1, 3] == 0, pack.occupied)
    assert np.all(indirection[[0, -1]][..., 3] == 1)
    every = slice(None)
    size = pack.padded_block_size
    parts = {
        "one": [("atlas_rgba", pack.atlas_rgba, every, 0), ("atlas_rgba", pack.atlas_features, every, size)],
        "two": [("atlas_rgba", pack.atlas_rgba, every, 0), ("atlas_features", pack.atlas_features, every, 0)],
        "paper": [("atlas_alpha", pack.atlas_rgba, slice(3, 4), 0), ("atlas_rgb", pack.atlas_rgba, slice(0, 3), 0),
                  ("atlas_features", pack.atlas_features, every, 0)],
    }[layout]  # fmt: skip
    assert scene.features_beside == (layout == "one")
    for name, atlas, channels, beside in parts:
        there = atlas_of(scene, name)
        for z, y, x in np.argwhere(pack.occupied):
            sx, sy, sz = pack.atlas_indices[z, y, x].astype(int) * size
            tx, ty, tz, _ = indirection[z + 1, y + 1, x + 1].astype(int) * size
            tx = tx * (2 if layout == "one" else 1) + beside
            expected = atlas[sz : sz + size, sy : sy + size, sx : sx + size, channels]
            assert np.array_equal(there[tz : tz + size, ty : ty + size, tx : tx + size], expected)
    scene.release()


def test_gpu_bytes_are_within_a_sixth_of_the_occupied_macroblocks(
    offscreen: Callable[..., OffscreenRenderer], real_pack: Pack
) -> None:
    voxels = int(real_pack.occupied.sum()) * real_pack.padded_block_size**3
    assert offscreen(real_pack).renderer.gpu_bytes() <= 1.15 * 4 * voxels


def test_a_texture_that_the_driver_refuses_is_told_in_one_line(ctx: moderngl.Context) -> None:
    if "llvmpipe" not in ctx.info["GL_RENDERER"]:
        pytest.skip("other drivers may have 32 GiB to spare")
    uploader = _Uploader(ctx)
    with pytest.raises(UserError, match="no room for the huge texture"):
        uploader.volume("huge", (2048, 2048, 2048), 4)
    uploader.give_up()


def test_diffuse_packs_upload_no_features(ctx: moderngl.Context) -> None:
    pack = random_pack(np.random.default_rng(1), diffuse=True)
    scene = upload(ctx, pack, "exact")
    assert "atlas_features" not in scene.textures
    scene.release()
