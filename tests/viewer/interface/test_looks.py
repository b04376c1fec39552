"""Themes that can be read, an interface of any size, what stands behind a scene, and what legends say about its colours."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.reference_marcher import render_reference
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.waiting import not_none
from viewer.core import theme
from viewer.features.display import panel as display_panel
from viewer.features.display.display import backdrop
from viewer.features.preferences.preferences import apply_preferences, current_preferences, load, save
from viewer.rendering.camera import ViewCamera, rays_through
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import Mode, RenderSettings

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
    ui: OffscreenUi = offscreen(app, pack, pack_folder)
    dark = ui.picture().astype(int)
    app.run("theme")
    ui.settle()
    light = ui.picture().astype(int)
    assert dark[10, 300].max() < 40 and light[10, 300].min() > 200
    width = app.viewport.width
    for _ in range(3):
        app.run("larger")
    ui.settle()
    assert app.interface.scale == 1.5 and app.viewport.width < width - 140 and ui.ui.scale == 1.5
    app.set(background=(0.0, 0.0, 0.0))
    file = tmp_path / "sub" / "viewer.json"
    assert save(current_preferences(app), file) is None
    again = type(app)()
    apply_preferences(again, load(file))
    assert (again.interface.theme, again.interface.scale) == ("light", 1.5)
    assert again.settings.background == (0.0, 0.0, 0.0)
    app.set(background=(1.0, 1.0, 1.0))
    app.run("usual-size")
    app.run("theme")
    ui.settle()
    assert abs(ui.picture().astype(int) - dark)[:40].mean() < 1
    for _ in range(20):
        app.run("larger")
    assert app.interface.scale == 2.0


@pytest.mark.parametrize("style", ["gradient", "checker"])
def test_a_backdrop_is_put_behind_by_opacity_after_all_shading(ctx, pack, style):
    camera = ViewCamera.orbit(pack, 35, 28, 2.9, fov_degrees=42, size=(60, 44))
    behind_it = not_none(backdrop(style, "dark"))
    y, x = (np.mgrid[:44, :60] + 0.5 - np.array([22, 30])[:, None, None]) / 44
    first, second = np.array(behind_it.first), np.array(behind_it.second)
    share = y + 0.5 if style == "gradient" else (np.floor(40 * x) + np.floor(40 * y)) % 2
    behind = first + share[..., None] * (second - first)
    reference = render_reference(pack, camera)
    through = 1.0 - reference.alpha[..., None]
    opaque = through[..., 0] < 1e-3
    assert opaque.any()
    with OffscreenRenderer(pack, ctx=ctx) as renderer:
        colours: dict[Mode, np.ndarray] = {"normal": reference.rgb, "diffuse": reference.diffuse}
        for mode, colour in colours.items():
            shown = renderer.render_float(camera, RenderSettings(mode=mode, backdrop=behind_it))
            plain = renderer.render_float(camera, RenderSettings(mode=mode))
            expected = np.clip(colour + through * (behind - 1.0), 0, 1)
            off = np.abs(shown - expected).max(axis=-1) > 1.5 / 255
            assert off.mean() < (0.005 if style == "gradient" else 0.04)  # squares' edges run through centres of pixels
            assert np.abs(shown - plain)[opaque].max() < 2 / 255
        alpha = [renderer.render(camera, RenderSettings(mode="alpha", backdrop=each)) for each in (None, behind_it)]
        assert np.array_equal(alpha[0], alpha[1])


def test_the_backdrop_goes_with_the_theme_and_a_plain_colour_ends_it(app):
    app.set(background=(0.0, 0.0, 0.0))
    app.set_backdrop("gradient")
    assert app.settings.background == (1.0, 1.0, 1.0)  # what the view MLP was trained with
    dark = app.settings.backdrop
    app.set_theme("light")
    assert app.settings.backdrop != dark and app.settings.backdrop.style == "gradient"
    app.set_backdrop("plain")
    assert app.settings.backdrop is None


@pytest.fixture
def ui(known_pack, offscreen, app, pack_folder):
    return offscreen(app, known_pack, pack_folder, size=(900, 640))


def test_the_numbers_of_the_depths_are_distances(ui, app):
    app.set(mode="depth")
    legend = not_none(display_panel.legend_of(app))
    near, far = float(legend.low), float(legend.high)
    camera = app.camera()
    shades = ui.canvas.raw(camera, replace(app.settings, mode="depth"))[..., 0]
    opacity = ui.canvas.raw(camera, replace(app.settings, mode="alpha"))[..., 0]
    y, x = np.argwhere(opacity > 0.999)[::400].T
    rays = rays_through(camera, np.stack([x + 0.5, y + 0.5], axis=1))  # one unit deep
    distances = ui.canvas.depth(camera, app.settings)[y, x] * np.linalg.norm(rays, axis=1)
    by_legend = near + (1 - shades[y, x] / opacity[y, x]) * (far - near)  # white is near
    assert len(x) > 20 and np.abs(by_legend - distances).max() < 0.02
    assert float(legend.middle) == pytest.approx((near + far) / 2, abs=0.01) and "units" in legend.unit


@pytest.mark.parametrize("mode", ["samples", "jumps"])
def test_the_costs_have_a_scale_that_follows_the_slider(ui, app, mode):
    app.set(mode=mode, cost_scale=32.0)
    legend = not_none(display_panel.legend_of(app))
    assert (legend.low, legend.middle, legend.high) == ("0", "16", "≥ 32") and "ray" in legend.unit
    counted = ui.canvas.raw(app.camera(), replace(app.settings, raw=True))
    shown = ui.canvas.raw(app.camera(), app.settings)[..., :3]
    count = counted[..., 0 if mode == "samples" else 1]
    stops = np.array(legend.stops)
    x = np.clip(count / 32.0, 0, 1) * (len(stops) - 1)
    wanted = np.stack([np.interp(x, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=-1)
    assert count.max() > 3 and np.abs(shown - wanted).mean() < 2e-3
