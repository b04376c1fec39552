"""What is said about colours and sides is what the picture shows."""

from dataclasses import replace

import moderngl
import numpy as np
import pytest

from tests.viewer.scenes import photographed
from viewer.features.display import panel as display_panel
from viewer.rendering.shader_source import assemble, colour_stops, compile_program


@pytest.fixture(scope="module")
def known(pack, tmp_path_factory):
    return photographed(pack, tmp_path_factory.mktemp("scene") / "toy_scene")


@pytest.fixture
def ui(known, offscreen, app, pack_folder):
    ui = offscreen(app, size=(900, 640))
    app.show(known, pack_folder)
    ui.settle()
    return ui


def test_the_bar_has_the_colours_of_the_shader(ctx):
    text = assemble("fullscreen.vert"), assemble("colour_map.glsl")
    body = text[1].text.replace("#version 330", "")
    source = replace(
        text[1],
        text="#version 330\n"
        + body
        + "\nout vec4 c; void main() { c = vec4(colour_map((gl_FragCoord.x - 0.5) / 80.0), 1); }",
    )
    program = compile_program(ctx, text[0], source)
    target = ctx.framebuffer([ctx.texture((81, 1), 4, dtype="f4")])
    target.use()
    ctx.vertex_array(program, []).render(moderngl.TRIANGLES, vertices=3)
    shown = np.frombuffer(target.read(components=3, dtype="f4"), "f4").reshape(81, 3)
    stops = np.array(colour_stops())
    x = np.linspace(0, len(stops) - 1, 81)
    wanted = np.stack([np.interp(x, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=1)
    assert len(stops) == 5 and np.abs(shown - wanted).max() < 1e-5


def test_the_numbers_of_the_depths_are_distances(ui, app):
    app.set(mode="depth")
    told = display_panel.legend_of(app)
    near, far = float(told.low), float(told.high)
    camera = app.camera()
    shades = ui.canvas.raw(camera, replace(app.settings, mode="depth"))[..., 0]
    opacity = ui.canvas.raw(camera, replace(app.settings, mode="alpha"))[..., 0]
    y, x = np.argwhere(opacity > 0.999)[::400].T
    distances = np.array(
        [ui.canvas.distance_at(camera, app.settings, a + 0.5, b + 0.5) for a, b in zip(x, y, strict=True)]
    )
    by_legend = near + (1 - shades[y, x] / opacity[y, x]) * (far - near)  # white is near
    assert len(x) > 20 and np.abs(by_legend - distances).max() < 0.02
    assert float(told.middle) == pytest.approx((near + far) / 2, abs=0.01) and "units" in told.unit


@pytest.mark.parametrize("mode", ["samples", "jumps"])
def test_the_costs_have_a_scale_that_follows_the_slider(ui, app, mode):
    app.set(mode=mode, cost_scale=32.0)
    told = display_panel.legend_of(app)
    assert (told.low, told.middle, told.high) == ("0", "16", "≥ 32") and "ray" in told.unit
    counted = ui.canvas.raw(app.camera(), replace(app.settings, mode="normal", counts=True))
    shown = ui.canvas.raw(app.camera(), app.settings)[..., :3]
    count = counted[..., 0 if mode == "samples" else 1]
    stops = np.array(told.stops)
    x = np.clip(count / 32.0, 0, 1) * (len(stops) - 1)
    wanted = np.stack([np.interp(x, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=-1)
    assert count.max() > 3 and np.abs(shown - wanted).mean() < 2e-3


def label_at(picture: np.ndarray, columns: slice, rows: slice) -> bool:
    """Whether a dark label with light text lies there, on a light picture."""
    part = picture[rows, columns].astype(int).max(axis=2)
    return bool((part < 80).mean() > 0.1 and (part > 200).any())


def test_both_sides_of_the_wipe_are_named(ui, app):
    app.gallery.stand_in(app, 1)
    assert app.comparison.sides(app) == ("Rendered", "Photograph")
    for split in (0.5, 0.3):
        app.comparison.split = split
        app.touch()
        ui.settle()
        edge, top = round(split * app.viewport.width), round(app.viewport.y) + 50
        rows = slice(top + 2, top + 28)
        assert label_at(ui.picture(), slice(edge - 90, edge - 10), rows)
        assert label_at(ui.picture(), slice(edge + 10, edge + 100), rows)
    app.comparison.how = "flip"
    app.comparison.clock = 0.0
    assert app.comparison.sides(app)[app.comparison.other_side] == "Rendered"
