"""What is uploaded: little more than the content, in textures that the driver really made."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from console import UserError
from scenepack.pack import Pack
from tests.reference_marcher import fetch
from tests.scenepack.random_packs import packs, random_pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.gpu_memory import Limits
from viewer.rendering.gpu_scene import GpuScene, tightest_atlas, upload
from viewer.rendering.renderer import Renderer
from viewer.rendering.skip_grid import CELL, chebyshev_distances, content_bounds, content_cells, skip_words


def atlas_of(scene: GpuScene, name: str) -> np.ndarray:
    texture = scene.textures[name]
    assert isinstance(texture, moderngl.Texture3D)
    x, y, z = scene.size
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
    limits = Limits(2048, 1.5 * room) if layout == "two" else Limits(2048)
    scene = upload(ctx, pack, "paper" if layout == "paper" else "exact", limits)
    texture = scene.textures["indirection"]
    assert isinstance(texture, moderngl.Texture3D)
    indirection = np.frombuffer(texture.read(alignment=1), np.uint8)
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


def test_what_a_camera_is_close_to_arrives_first(ctx: moderngl.Context) -> None:
    """A layer of the atlas at a time: the one that holds the closest macroblock."""
    pack = random_pack(np.random.default_rng(2), block_size=30, grid_blocks=(6, 6, 6), occupancy=0.02, style="noise")
    renderer = Renderer(ctx, pack, at_once=False)
    scene = renderer.scene("exact")
    assert scene.slots[2] > 4
    middles = (np.argwhere(pack.occupied)[:, ::-1] + 0.5) * pack.block_size
    layers = np.arange(len(middles)) // (scene.slots[0] * scene.slots[1])
    shown = np.zeros(len(middles), bool)
    for near in ([0.0, 0.0, 0.0], [180.0, 180.0, 180.0], [0.0, 180.0, 90.0]):
        eye = pack.min_xyz + np.array(near) * pack.voxel_size
        renderer.see_first(ViewCamera.look_at(eye, pack.min_xyz + 90.5 * pack.voxel_size, size=(8, 8)))
        renderer.arrive(0.0)
        scene.show_arrived()
        there = arrived(scene, pack)
        new = np.unique(layers[there & ~shown])
        assert len(new) == 1 and np.array_equal(there & ~shown, layers == new[0])
        away = np.linalg.norm(middles - near, axis=1)
        assert away[layers == new[0]].min() <= away[~there].min()
        shown = there
    renderer.release()


def arrived(scene: GpuScene, pack: Pack) -> np.ndarray:
    """bool [macroblocks, in the grid's order]: those that rays see."""
    texture = scene.textures["indirection"]
    assert isinstance(texture, moderngl.Texture3D)
    indirection = np.frombuffer(texture.read(alignment=1), np.uint8)
    indirection = indirection.reshape(*(n + 2 for n in pack.occupied.shape), 4)
    return indirection[1:-1, 1:-1, 1:-1, 3][pack.occupied] == 0


# The skip grid never hides content and its distances are the largest that are safe


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(pack=packs(block_sizes=(3, 5, 14, 30)), seed=st.integers(0, 2**32 - 1))
def test_no_sample_in_a_cell_without_content_has_any_opacity(pack: Pack, seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0, pack.grid_size, (4000, 3))
    # Borders of macroblocks and of voxels are where a mistake would be.
    edges = rng.random(positions.shape) < 0.3
    positions = np.where(edges, np.round(2 * positions) / 2, positions).clip(0, np.array(pack.grid_size) - 1e-9)
    content = content_cells(pack)
    cells = np.floor((positions + 0.5) / CELL).astype(int)
    empty = ~content[cells[:, 2], cells[:, 1], cells[:, 0]]
    rgba, _ = fetch(pack, positions)
    assert not np.any(rgba[empty, 3] > 0)
    low, high = content_bounds(content)
    outside = np.any((positions < low) | (positions > high), axis=1)
    assert not np.any(rgba[outside, 3] > 0)


@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(pack=packs(block_sizes=(3, 5, 14, 30)))
def test_words_hold_the_distances_of_cells_and_the_content_of_their_eighths(pack: Pack) -> None:
    eighths = content_cells(pack, CELL // 2)
    words = skip_words(eighths)
    content = content_cells(pack)
    z, y, x = content.shape
    assert np.array_equal(words[:z, :y, :x] & 255, chebyshev_distances(words & 255 == 0)[:z, :y, :x])
    assert np.array_equal(words[:z, :y, :x] & 255 == 0, content)
    for k, j, i in np.argwhere(np.ones_like(eighths)):
        bit = 8 + i % 2 + 2 * (j % 2) + 4 * (k % 2)
        assert words[k // 2, j // 2, i // 2] >> bit & 1 == eighths[k, j, i]


@pytest.mark.parametrize("seed", range(6))
def test_chebyshev_distances_are_those_of_a_plain_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    content = rng.random((9, 12, 7)) < (0.01, 0.1)[seed % 2]
    content[tuple(rng.integers(0, n) for n in content.shape)] = True
    places = np.argwhere(content)
    everywhere = np.stack(np.indices(content.shape), axis=-1)
    expected = np.abs(everywhere[..., None, :] - places).max(axis=-1).min(axis=-1)
    assert np.array_equal(chebyshev_distances(content), expected)
