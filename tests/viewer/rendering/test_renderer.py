"""Drawing: independent of what others left in OpenGL, of the viewport's place, and of what was drawn before."""

import sys
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from console import UserError
from scenepack.pack import Pack
from tests.viewer.rendering.golden_variants import camera_for
from tests.viewer.texture_limits import limit_textures
from viewer.rendering import supersampling
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer, create_context
from viewer.rendering.opengl import free_framebuffer, unbind_framebuffers
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


@pytest.mark.parametrize("kind", ["ndc_shapes", "diffuse"])  # test_golden.py: the usual kind
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


# Anti-aliased pictures are the exact mean of rays

WIDTH, HEIGHT = 50, 37


def view(pack: Pack, scale: int = 1) -> ViewCamera:
    return camera_for(pack).resized(scale * WIDTH, scale * HEIGHT)


@pytest.mark.parametrize(("which", "mode"), [("shapes", "normal"), ("ndc_shapes", "alpha")])
def test_a_picture_with_n_samples_is_the_box_filtered_picture_n_times_as_large(request, offscreen, which, mode):
    pack: Pack = request.getfixturevalue(which)
    renderer, samples = offscreen(pack), 3
    large = renderer.render_float(view(pack, samples), RenderSettings(mode=mode)).astype(np.float64)
    mean = large.reshape(HEIGHT, samples, WIDTH, samples, 3).mean(axis=(1, 3))
    smooth = renderer.render_float(view(pack), RenderSettings(mode=mode, samples=samples))
    np.testing.assert_allclose(smooth, mean, rtol=0, atol=1e-5)
    assert np.abs(renderer.render_float(view(pack), RenderSettings(mode=mode)) - mean).max() > 0.05  # edges differ
    rounded = renderer.render(view(pack), RenderSettings(mode=mode, samples=samples))
    assert np.abs(rounded - 255 * mean).max() <= 0.51  # rounded once, behind the mean


def test_tiles_make_the_same_picture_in_its_place_and_nowhere_else(ctx, offscreen, shapes, monkeypatch):
    renderer, settings = offscreen(shapes), RenderSettings(samples=3)
    whole = renderer.render(view(shapes), settings).astype(int)
    monkeypatch.setattr(supersampling, "TILE", 48)  # 16 x 16 pixels: 4 x 3 tiles
    framebuffer = ctx.simple_framebuffer((WIDTH + 9, HEIGHT + 5), 4)
    framebuffer.clear(1, 0, 1)
    framebuffer.scissor = (3, 4, 5, 6)  # such as imgui leaves
    renderer.renderer.render(framebuffer, view(shapes), settings, (4, 3))
    framebuffer.scissor = None
    data = framebuffer.read(components=3, alignment=1)
    pixels = np.frombuffer(data, np.uint8).reshape(HEIGHT + 5, WIDTH + 9, 3)
    place = slice(3, 3 + HEIGHT), slice(4, 4 + WIDTH)
    difference = np.abs(pixels[place][::-1] - whole)
    assert difference.max() <= 4 and (difference > 1).mean() < 1e-3
    outside = pixels.copy()
    outside[place] = (255, 0, 255)
    assert (outside == (255, 0, 255)).all()
    unbind_framebuffers(ctx)
    free_framebuffer(framebuffer)
