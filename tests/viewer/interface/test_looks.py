"""Themes that can be read, an interface of any size, and what stands behind a scene."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from imgui_bundle import ImVec2, imgui

from tests.reference_marcher import render_reference
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.scenes import photographed
from viewer.app.commands import run
from viewer.core import theme
from viewer.features.display.display import STYLES, backdrop
from viewer.features.preferences.preferences import (
    Preferences,
    apply_preferences,
    current_preferences,
    load,
    save,
)
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings, of_picture

GROUNDS = ("base", "panel", "card", "control")
INKS = ("text", "muted", "faint", "accent", "good", "warn", "bad")


def luminance(code: str) -> float:
    """Relative luminance, WCAG 2."""
    channels = np.array([int(code[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(a: str, b: str) -> float:
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("name", theme.THEMES)
def test_all_text_can_be_read_on_all_that_it_stands_on(name):
    palette = theme.PALETTES[name]
    assert palette.keys() == theme.PALETTES["dark"].keys()
    for ink, ground in itertools.product(INKS, GROUNDS):
        least = 4.5 if ink in ("text", "muted") else 3.4 if ground == "control" else 4.0
        assert contrast(palette[ink], palette[ground]) >= least, (ink, ground)
    assert contrast(palette["on-accent"], palette["accent"]) >= 4.5
    assert contrast(palette["on-accent"], palette["text"]) >= 4.5  # the main button under the mouse
    assert contrast(palette["text"], palette["deep"]) >= 3.0


def test_the_theme_and_the_size_change_at_once_and_are_remembered(offscreen, app, pack, pack_folder, tmp_path):
    ui: OffscreenUi = offscreen(app)
    app.show(pack, pack_folder)
    ui.settle()
    dark = ui.picture().astype(int)
    run(app, "theme")
    ui.settle()
    light = ui.picture().astype(int)
    assert dark[10, 300].max() < 40 and light[10, 300].min() > 200
    width = app.viewport.width
    for _ in range(3):
        run(app, "larger")
    ui.settle()
    assert app.interface.scale == 1.5 and app.viewport.width < width - 140 and ui.ui.scale == 1.5
    file = tmp_path / "viewer.json"
    assert save(current_preferences(app), file) is None
    again = type(app)()
    apply_preferences(again, load(file))
    assert (again.interface.theme, again.interface.scale) == ("light", 1.5)
    run(app, "usual-size"), run(app, "theme")
    ui.settle()
    assert abs(ui.picture().astype(int) - dark)[:40].mean() < 1
    for _ in range(20):
        run(app, "larger")
    assert app.interface.scale == 2.0


def test_settings_that_make_no_sense_keep_their_defaults(tmp_path):
    file = tmp_path / "viewer.json"
    file.write_text('{"background": [1, 1, 1], "interface_scale": 99, "theme": "mauve"}')
    found = load(file)
    assert (found.backdrop, found.interface_scale) == ("gradient", 2.0) == (Preferences().backdrop, 2.0)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("mode", ["normal", "diffuse", "alpha"])
def test_a_backdrop_is_put_behind_by_opacity_after_all_shading(ctx, pack, style, mode):
    camera = ViewCamera.orbit(pack, 35, 28, 2.9, fov_degrees=42, size=(60, 44))
    wanted = RenderSettings(mode=mode, backdrop=backdrop(style, "dark"))
    renderer = OffscreenRenderer(pack, ctx=ctx)
    shown = renderer.render_float(camera, wanted)
    plain = renderer.render_float(camera, RenderSettings(mode=mode))
    renderer.release()
    if mode == "alpha":
        assert np.array_equal(shown, plain)
        return
    y, x = (np.mgrid[:44, :60] + 0.5 - np.array([22, 30])[:, None, None]) / 44
    first, second = np.array(wanted.backdrop.first), np.array(wanted.backdrop.second)
    share = y + 0.5 if style == "gradient" else (np.floor(40 * x) + np.floor(40 * y)) % 2
    behind = first + share[..., None] * (second - first)
    reference = render_reference(pack, camera)
    through = 1.0 - reference.alpha[..., None]
    expected = np.clip((reference.rgb if mode == "normal" else reference.diffuse) + through * (behind - 1.0), 0, 1)
    off = np.abs(shown - expected).max(axis=-1) > 1.5 / 255
    assert off.mean() < (0.005 if style == "gradient" else 0.04)  # squares' edges run through centres of pixels
    opaque = through[..., 0] < 1e-3
    assert opaque.any() and np.abs(shown - plain)[opaque].max() < 2 / 255


@pytest.mark.parametrize("style", STYLES)
def test_tiles_of_a_picture_have_one_backdrop(ctx, pack, style):
    whole = ViewCamera.orbit(pack, 35, 28, 2.9, fov_degrees=42, size=(64, 48))
    wanted = of_picture(RenderSettings(backdrop=backdrop(style, "light")), whole.height, whole.fy)
    renderer = OffscreenRenderer(pack, ctx=ctx)
    expected = renderer.render(whole, RenderSettings(backdrop=backdrop(style, "light")))
    part = replace(whole, width=20, height=16, cx=whole.cx - 40, cy=whole.cy - 30)
    tile = renderer.render(part, wanted)
    larger = renderer.render(part.resized(40, 32), wanted)
    renderer.release()
    assert np.abs(tile.astype(int) - expected[30:46, 40:60]).max() <= 1
    assert np.abs(larger[::2, ::2].astype(int).mean() - tile.mean()) < 3


def test_a_photograph_is_compared_over_the_plain_background(offscreen, app, pack, tmp_path):
    ui = offscreen(app, size=(700, 500))
    app.show(photographed(pack, tmp_path / "scene", 2), tmp_path / "toy")
    app.set_backdrop("checker")
    app.gallery.stand_in(app, 0)
    ui.settle()
    assert app.comparison.psnr_db is not None and app.comparison.psnr_db > 40


def test_the_backdrop_goes_with_the_theme_and_a_plain_colour_ends_it(app):
    app.set(background=(0.0, 0.0, 0.0))
    app.set_backdrop("gradient")
    assert app.settings.background == (1.0, 1.0, 1.0)  # what the view MLP was trained with
    dark = app.settings.backdrop
    app.set_theme("light")
    assert app.settings.backdrop != dark and app.settings.backdrop.style == "gradient"
    app.set_backdrop("plain")
    assert app.settings.backdrop is None


def test_what_was_larger_for_a_while_leaves_no_size_behind(offscreen, app):
    """imgui's scale_all_sizes multiplies what is there: the least size of a window grew with each change of theme or size."""
    ui: OffscreenUi = offscreen(app)

    def sizes() -> dict[str, object]:
        imgui.set_current_context(ui.ui.context)
        style = imgui.get_style()
        found = {name: getattr(style, name) for name in dir(style) if not name.startswith("_")}
        return {
            name: (value.x, value.y) if isinstance(value, ImVec2) else value
            for name, value in found.items()
            if isinstance(value, float | int | ImVec2)
        }

    ui.frame()
    before = sizes()
    for _ in range(3):
        run(app, "theme")
        run(app, "larger")
        ui.frame()
    for _ in range(3):
        run(app, "smaller")
        ui.frame()
    run(app, "theme")
    ui.frame()
    assert sizes() == before and before["window_min_size"] == (32.0, 32.0)
