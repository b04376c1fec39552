"""Anti-aliased pictures are the exact mean of rays."""

from __future__ import annotations

from collections.abc import Callable

import moderngl
import numpy as np
import pytest

from scenepack.pack import Pack
from viewer.rendering import supersampling
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.opengl import free_framebuffer, unbind_framebuffers
from viewer.rendering.settings import Mode, RenderSettings

Make = Callable[..., OffscreenRenderer]
WIDTH, HEIGHT = 50, 37


def view(pack: Pack, scale: int = 1) -> ViewCamera:
    size = (scale * WIDTH, scale * HEIGHT)
    if pack.ndc:
        return ViewCamera.look_at((0.3, 0.2, 0), (0, 0, 4), fov_degrees=50, size=size, mirrored=True)
    return ViewCamera.orbit(pack, 35, 28, 2.9, fov_degrees=42, size=size)


def box_filtered(picture: np.ndarray, n: int) -> np.ndarray:
    return picture.astype(np.float64).reshape(HEIGHT, n, WIDTH, n, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("samples", [2, 3])
@pytest.mark.parametrize("mode", ["normal", "alpha"])
@pytest.mark.parametrize("which", ["shapes", "ndc_shapes"])
def test_a_picture_with_n_samples_is_the_box_filtered_picture_n_times_as_large(
    request: pytest.FixtureRequest, offscreen: Make, which: str, mode: Mode, samples: int
) -> None:
    pack: Pack = request.getfixturevalue(which)
    renderer = offscreen(pack)
    mean = box_filtered(renderer.render_float(view(pack, samples), RenderSettings(mode=mode)), samples)
    smooth = renderer.render_float(view(pack), RenderSettings(mode=mode, samples=samples))
    np.testing.assert_allclose(smooth, mean, rtol=0, atol=1e-5)
    assert np.abs(renderer.render_float(view(pack), RenderSettings(mode=mode)) - mean).max() > 0.05  # edges differ
    rounded = renderer.render(view(pack), RenderSettings(mode=mode, samples=samples))
    assert np.abs(rounded - 255 * mean).max() <= 0.51  # rounded once, behind the mean


def test_tiles_make_the_same_picture_in_its_place_and_nowhere_else(
    ctx: moderngl.Context, offscreen: Make, shapes: Pack, monkeypatch: pytest.MonkeyPatch
) -> None:
    renderer, settings = offscreen(shapes), RenderSettings(samples=3)
    whole = renderer.render(view(shapes), settings).astype(int)
    monkeypatch.setattr(supersampling, "TILE", 48)  # 16 x 16 pixels: 4 x 3 tiles
    framebuffer = ctx.simple_framebuffer((WIDTH + 9, HEIGHT + 5), 4)
    framebuffer.clear(1, 0, 1)
    framebuffer.scissor = (3, 4, 5, 6)  # such as imgui leaves
    renderer.renderer.render(framebuffer, view(shapes), settings, (4, 3, WIDTH, HEIGHT))
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
