"""Packs that are too large for the card: half the resolution, the same place, a warning with both sizes."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from console import Notice
from scenepack import Pack
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.texture_limits import limit_textures
from viewer.rendering import canvas as canvas_module
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.gpu_memory import half_resolution
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

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
    thin = replace(half, atlas_rgba=half.atlas_rgba // 2, atlas_features=half.atlas_features // 2)
    assert psnr(whole, halved) > 20
    assert psnr(whole, halved) > psnr(whole, offscreen(thin).render_float(camera)) + 1


@pytest.mark.parametrize(("marcher", "limits"), [("exact", (PLENTY, 400_000)), ("paper", (48,))])
def test_a_pack_too_large_for_the_card_is_shown_at_half_resolution_with_both_sizes_told(
    ctx: moderngl.Context, shapes: Pack, limits: tuple[int, ...], marcher: str, monkeypatch: pytest.MonkeyPatch
) -> None:
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
