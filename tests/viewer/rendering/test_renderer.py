"""Drawing: independent of what others left in OpenGL, of the viewport's place, and of what was drawn before."""

import sys
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from baker.metrics import psnr
from console import Notice, UserError
from scenepack import Pack
from tests.scenepack.random_packs import random_pack
from tests.viewer.rendering.golden_variants import VARIANTS, camera_for
from tests.viewer.rendering.pictures import compare_with_golden
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.texture_limits import limit_textures
from tests.viewer.waiting import not_none
from viewer.rendering import canvas as canvas_module
from viewer.rendering import supersampling
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.gpu_scene import half_resolution, tightest_atlas
from viewer.rendering.offscreen import OffscreenRenderer, create_context
from viewer.rendering.opengl import free_framebuffer, unbind_framebuffers
from viewer.rendering.renderer import Renderer
from viewer.rendering.settings import MODES, RenderSettings


@pytest.fixture
def camera(shapes: Pack) -> ViewCamera:
    return ViewCamera.orbit(shapes, 35, size=(64, 48))


@pytest.mark.parametrize("marcher", ["exact", "brute", "paper"])
def test_state_that_imgui_leaves_behind_changes_nothing(ctx, offscreen, shapes, camera, marcher):
    renderer = offscreen(shapes)
    wanted = RenderSettings(marcher=marcher)
    expected = renderer.render(camera, wanted)
    framebuffer = renderer.framebuffer(64, 48)
    framebuffer.scissor = (3, 4, 5, 6)
    framebuffer.viewport = (1, 2, 3, 4)
    framebuffer.color_mask = (True, False, False, True)
    ctx.enable_only(moderngl.BLEND | moderngl.CULL_FACE | moderngl.DEPTH_TEST)
    ctx.blend_func = moderngl.ONE, moderngl.ONE
    ctx.front_face, ctx.cull_face = "cw", "front_and_back"
    ctx.wireframe = True
    sampler = ctx.sampler(filter=(moderngl.NEAREST, moderngl.NEAREST))
    for unit in range(6):
        sampler.use(unit)
    try:
        assert np.array_equal(renderer.render(camera, wanted), expected)
    finally:
        ctx.wireframe = False
        ctx.clear_samplers(0, 6)
        sampler.release()


@pytest.mark.parametrize("kind", ["ndc_shapes", "diffuse"])  # the golden pictures have the usual kind
def test_every_mode_of_every_kind_of_pack_draws_something_finite(request, offscreen, kind, shapes):
    diffuse = replace(shapes, atlas_features=None, view_mlp=None)
    pack = diffuse if kind == "diffuse" else request.getfixturevalue(kind)
    camera, renderer = camera_for(pack).resized(48, 36), offscreen(pack)
    for mode in MODES:
        picture = renderer.render_float(camera, RenderSettings(mode=mode))
        assert np.isfinite(picture).all() and picture.min() >= 0 and picture.max() <= 1, mode
        empty = kind == "diffuse" and mode in ("features", "view-dependent")
        assert (picture.std() == 0) == empty, mode


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only EGL tells which context is current")
def test_a_program_has_its_own_context_back_when_a_renderer_is_released(shapes, camera, monkeypatch):
    pixels = bytes(range(16))
    for refused in (False, True):
        own = create_context()
        texture = own.texture((2, 2), 4, pixels)
        if refused:
            limit_textures(monkeypatch, 16)
            with pytest.raises(UserError):
                OffscreenRenderer(shapes, allow_half=False)
        else:
            with OffscreenRenderer(shapes) as one, OffscreenRenderer(shapes) as other:
                assert np.array_equal(one.render(camera), other.render(camera))
        assert texture.read() == pixels and own.error == "GL_NO_ERROR"
        own.release()


def test_a_pack_whose_features_need_an_atlas_of_their_own_looks_the_same(ctx, offscreen, shapes, camera, monkeypatch):
    expected = offscreen(shapes).render(camera)
    bytes_of_one = int(shapes.occupied.sum()) * shapes.padded_block_size**3 * 4
    limit_textures(monkeypatch, most_bytes=1.5 * bytes_of_one)
    with OffscreenRenderer(shapes, ctx=ctx) as renderer:
        assert not renderer.renderer.scene("exact").features_beside
        assert np.array_equal(renderer.render(camera), expected)


def test_tiles_make_the_same_picture_in_its_place_and_nowhere_else(ctx, offscreen, shapes, monkeypatch):
    renderer, settings = offscreen(shapes), RenderSettings(samples=3)
    width, height = 50, 37
    camera = camera_for(shapes).resized(width, height)
    whole = renderer.render(camera, settings).astype(int)
    monkeypatch.setattr(supersampling, "TILE", 48)  # 16 x 16 pixels: 4 x 3 tiles
    framebuffer = ctx.simple_framebuffer((width + 9, height + 5), 4)
    framebuffer.clear(1, 0, 1)
    framebuffer.scissor = (3, 4, 5, 6)  # such as imgui leaves
    renderer.renderer.render(framebuffer, camera, settings, (4, 3))
    framebuffer.scissor = None
    data = framebuffer.read(components=3, alignment=1)
    pixels = np.frombuffer(data, np.uint8).reshape(height + 5, width + 9, 3)
    place = slice(3, 3 + height), slice(4, 4 + width)
    difference = np.abs(pixels[place][::-1] - whole)
    assert difference.max() <= 4 and (difference > 1).mean() < 1e-3
    outside = pixels.copy()
    outside[place] = (255, 0, 255)
    assert (outside == (255, 0, 255)).all()
    unbind_framebuffers(ctx)
    free_framebuffer(framebuffer)


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
        texture = scene.textures["indirection"]
        assert isinstance(texture, moderngl.Texture3D)
        indirection = np.frombuffer(texture.read(alignment=1), np.uint8).reshape(
            *(n + 2 for n in pack.occupied.shape), 4
        )
        there = indirection[1:-1, 1:-1, 1:-1, 3][pack.occupied] == 0  # the macroblocks that rays see
        new = np.unique(layers[there & ~shown])
        assert len(new) == 1 and np.array_equal(there & ~shown, layers == new[0])
        away = np.linalg.norm(middles - near, axis=1)
        assert away[layers == new[0]].min() <= away[~there].min()
        shown = there
    renderer.release()


@pytest.mark.parametrize("side", [140, 141])
def test_the_picture_stays_much_the_same_in_the_same_place(offscreen, side):
    pack = shapes_pack(side, 30)
    camera = ViewCamera.orbit(pack, 35, 28, size=(120, 90))
    whole = offscreen(pack).render_float(camera)
    half = half_resolution(pack)
    assert half.grid_size == (-(-side // 2),) * 3 and half.voxel_size == 2 * pack.voxel_size
    halved = offscreen(half).render_float(camera)
    thin = replace(half, atlas_rgba=half.atlas_rgba // 2, atlas_features=not_none(half.atlas_features) // 2)
    assert psnr(whole, halved) > 20
    assert psnr(whole, halved) > psnr(whole, offscreen(thin).render_float(camera)) + 1


@pytest.mark.parametrize(("marcher", "limits"), [("exact", {"most_bytes": 400_000}), ("paper", {"largest_side": 48})])
def test_a_pack_too_large_for_the_card_is_shown_at_half_resolution_and_told(ctx, shapes, limits, marcher, monkeypatch):
    limit_textures(monkeypatch, **limits)
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


@pytest.mark.parametrize("name", VARIANTS)
def test_each_picture_looks_as_before(request: pytest.FixtureRequest, offscreen, name: str) -> None:
    pack, wanted = VARIANTS[name]
    renderer = offscreen(request.getfixturevalue(pack))
    picture = renderer.render(camera_for(renderer.pack), wanted)
    assert picture.std() > 5, "there is nothing to see"
    compare_with_golden(request.config, renderer.ctx.info["GL_RENDERER"], name, picture)
