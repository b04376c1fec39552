"""What is uploaded: little more than the content, in textures that the driver really made."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from console import Notice, UserError
from scenepack import Pack
from tests.scenepack.random_packs import random_pack
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.texture_limits import limit_textures
from tests.viewer.waiting import there
from viewer.rendering import canvas as canvas_module
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.gpu_scene import GpuScene, half_resolution, tightest_atlas
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.renderer import Renderer
from viewer.rendering.settings import RenderSettings
from viewer.rendering.skip_grid import chebyshev_distances


@pytest.mark.parametrize("count", [1, 2, 3, 7, 63, 64, 65, 455, 753, 4000, 4097, 5003, 62_000])
@pytest.mark.parametrize("max_side", [1024, 2048])
def test_the_atlas_has_room_for_all_blocks_and_next_to_no_more(count: int, max_side: int) -> None:
    if count > (max_side // 32) ** 3:
        with pytest.raises(UserError, match="too large"):
            tightest_atlas(count, 32, max_side)
        return
    slots = tightest_atlas(count, 32, max_side)
    assert count <= np.prod(slots) <= max(1.02 * count, count + 1) and max(slots) * 32 <= max_side


def test_what_a_camera_is_close_to_arrives_first(ctx: moderngl.Context) -> None:
    """A layer of the atlas at a time: the one that holds the closest macroblock."""
    pack = random_pack(np.random.default_rng(2), block_size=14, grid_blocks=(6, 6, 6), occupancy=0.02, style="noise")
    renderer = Renderer(ctx, pack, at_once=False)
    scene = renderer.scene("exact")
    assert scene.slots[2] > 4
    middles = (np.argwhere(pack.occupied)[:, ::-1] + 0.5) * pack.block_size
    layers = np.arange(len(middles)) // (scene.slots[0] * scene.slots[1])
    shown = np.zeros(len(middles), bool)
    for near in ([0.0, 0.0, 0.0], [84.0, 84.0, 84.0], [0.0, 84.0, 42.0]):
        eye = pack.min_xyz + np.array(near) * pack.voxel_size
        renderer.see_first(ViewCamera.look_at(eye, pack.min_xyz + 42.5 * pack.voxel_size, size=(8, 8)))
        renderer.arrive(0.0)
        scene.textures["indirection"].write(scene._indirection(), alignment=1)
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


@pytest.mark.parametrize("seed", range(6))
def test_chebyshev_distances_are_those_of_a_plain_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    content = rng.random((9, 12, 7)) < (0.01, 0.1)[seed % 2]
    content[tuple(rng.integers(0, n) for n in content.shape)] = True
    places = np.argwhere(content)
    everywhere = np.moveaxis(np.indices(content.shape), 0, -1)
    expected = np.abs(everywhere[..., None, :] - places).max(axis=-1).min(axis=-1)
    assert np.array_equal(chebyshev_distances(content), expected)


# Packs that are too large for the card: half the resolution, the same place, a warning with both sizes


PLENTY = 2048


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((a.astype(np.float64) - b) ** 2)))


@pytest.mark.parametrize("side", [140, 141])
def test_the_picture_stays_much_the_same_in_the_same_place(offscreen, side):
    pack = shapes_pack(side, 30)
    camera = ViewCamera.orbit(pack, 35, 28, size=(120, 90))
    whole = offscreen(pack).render_float(camera)
    half = half_resolution(pack)
    assert half.grid_size == (-(-side // 2),) * 3 and half.voxel_size == 2 * pack.voxel_size
    halved = offscreen(half).render_float(camera)
    thin = replace(half, atlas_rgba=half.atlas_rgba // 2, atlas_features=there(half.atlas_features) // 2)
    assert psnr(whole, halved) > 20
    assert psnr(whole, halved) > psnr(whole, offscreen(thin).render_float(camera)) + 1


@pytest.mark.parametrize(("marcher", "limits"), [("exact", (PLENTY, 400_000)), ("paper", (48,))])
def test_a_pack_too_large_for_the_card_is_shown_at_half_resolution_and_that_is_told(
    ctx, shapes, limits, marcher, monkeypatch
):
    limit_textures(monkeypatch, *limits)
    with (
        pytest.warns(Notice, match=r"half resolution, 35x35x35 voxels.*70x70x70 voxels") as caught,
        OffscreenRenderer(shapes, marcher, ctx) as renderer,
    ):
        assert renderer.pack.grid_size == (35, 35, 35)
        assert renderer.render(ViewCamera.orbit(shapes, 35, size=(32, 24))).std() > 5
    assert len(caught) == 1 and "\n" not in str(caught[0].message)


@pytest.mark.slow
def test_a_canvas_goes_on_drawing_until_all_of_a_pack_has_arrived(ctx, shapes, monkeypatch):
    monkeypatch.setattr(canvas_module, "ARRIVING_S", 1e-9)
    canvas, settings = Canvas(ctx), RenderSettings()
    canvas.rest_s = canvas.blend_s = 0.0
    canvas.show(shapes)
    camera, frames = ViewCamera.orbit(shapes, 35, size=(48, 36)), 0
    while canvas.pending and frames < 200:
        if not canvas.follow(camera, settings, DynamicResolution()):
            canvas.sharpen(camera, settings, DynamicResolution())
        frames += 1
    assert canvas.renderer is not None and not canvas.renderer.arriving and 2 < frames < 200
    with OffscreenRenderer(shapes, ctx=ctx) as complete:
        assert np.array_equal(canvas.snapshot(camera, settings), complete.render(camera))
    canvas.close()
