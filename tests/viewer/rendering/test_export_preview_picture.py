"""The picture of an export before it is written: where the pack is, in its colours, seen by the same camera."""

import moderngl
import numpy as np
import pytest

from scenepack.exports.scene import KINDS, Export, preview_geometry
from tests.viewer.conftest import toy_pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import RenderSettings

GROUND = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("parallel", [False, True])
def test_a_preview_is_seen_where_the_pack_is_in_its_colours(ctx: moderngl.Context, kind, parallel: bool) -> None:
    pack = toy_pack()
    camera = ViewCamera.orbit(pack, 205.0, size=(160, 120))
    camera = camera.as_orthographic(2.6) if parallel else camera
    canvas = Canvas(ctx)
    try:
        canvas.show(pack)
        alpha = canvas.raw(camera, RenderSettings(mode="alpha", raw=True))[..., 0] > 0.5
        diffuse = canvas.snapshot(camera, RenderSettings(mode="diffuse"))
        drawn = canvas.draw_export_preview(preview_geometry(pack, Export(kind)), camera, GROUND)
        seen = drawn.any(axis=2)
        assert (seen & alpha).sum() / (seen | alpha).sum() > 0.9  # points are squares that stick out
        assert (drawn.argmax(axis=2) == diffuse.argmax(axis=2))[seen & alpha].mean() > 0.95
        assert np.array_equal(canvas.snapshot(camera, RenderSettings(mode="diffuse")), diffuse), "nothing is left set"
        canvas.drop_export_preview()
        assert ctx.error == "GL_NO_ERROR"
    finally:
        canvas.close()
