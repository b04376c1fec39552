"""A look changes the scene's colours as the formulas say, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from viewer.rendering.camera import ViewCamera
from viewer.rendering.layers import straight_rgba
from viewer.rendering.settings import Backdrop, Look, RenderSettings

DARK = (0.1, 0.2, 0.3)


def looked(colour: np.ndarray, look: Look) -> np.ndarray:
    """sRGB [..., 3] with a look."""
    light = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4) * look.gain
    grey = light @ np.array([0.2126, 0.7152, 0.0722])
    light = np.clip(grey[..., None] + look.saturation * (light - grey[..., None]), 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(
    ("kind", "look"),
    [("shapes", Look(-2.0, 0.7, -0.4)), ("shapes", Look(saturation=0.0)), ("ndc_shapes", Look(0.3, -1.0, 1.0, 2.0))],
)
def test_opaque_colours_are_those_of_the_formula_and_the_background_is_left_alone(request, offscreen, kind, look):
    pack = request.getfixturevalue(kind)
    renderer = offscreen(pack)
    camera = ViewCamera.look_at((0, 0, 0), (0.2, 0.1, 4), mirrored=True) if pack.ndc else ViewCamera.orbit(pack, 35)
    camera = camera.resized(96, 72)
    for mode in ("normal", "diffuse"):
        plain = RenderSettings(mode=mode, background=DARK)
        before, after = (renderer.render_float(camera, each) for each in (plain, replace(plain, look=look)))
        alpha = renderer.render_float(camera, RenderSettings(mode="alpha"))[..., 0]
        solid, empty = alpha > 0.996, alpha == 0
        off = np.abs(after[solid] - looked(before[solid], look))
        assert solid.mean() > 0.05 and off.max() < 0.016  # 1/255 of the light is left
        assert np.array_equal(after[empty], before[empty])
    for mode in ("depth", "alpha", "macroblocks", "features"):
        shown = [renderer.render(camera, RenderSettings(mode=mode, look=each)) for each in (None, look)]
        assert np.array_equal(*shown)


def test_colours_as_they_are_and_what_lies_behind_do_not_change(shapes, offscreen) -> None:
    renderer, camera = offscreen(shapes), ViewCamera.orbit(shapes, 35, size=(96, 72))
    plain = RenderSettings(background=DARK)
    same = np.abs(renderer.render_float(camera, plain) - renderer.render_float(camera, replace(plain, look=Look())))
    assert same.max() < 2e-3
    wanted = replace(plain, look=Look(1.0, 0.5), backdrop=Backdrop("gradient", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    before, after = (renderer.render(camera, each) for each in (replace(wanted, look=None), wanted))
    empty = renderer.render(camera, RenderSettings(mode="alpha"))[..., 0] == 0
    assert np.array_equal(before[empty], after[empty]) and np.abs(before.astype(int) - after).mean() > 5


def test_a_transparent_picture_has_the_same_look(shapes, offscreen) -> None:
    renderer, camera = offscreen(shapes), ViewCamera.orbit(shapes, 35, size=(96, 72))
    wanted = RenderSettings(look=Look(-0.5, 0.5, 0.0, 1.2))
    rgba = straight_rgba(renderer.render_raw(camera, replace(wanted, raw=True))).astype(float) / 255
    over = rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]
    off = 255 * np.abs(over - renderer.render_float(camera, wanted))
    assert np.percentile(off, 99) < 2
