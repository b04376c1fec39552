"""What is said about colours and sides is what the picture shows."""

from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
import pytest

from tests.viewer.conftest import toy_pack
from tests.viewer.rendering.shapes import surroundings_pack
from tests.viewer.scenes import photographed
from viewer.features.display import panel as display_panel
from viewer.rendering.settings import MODES
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
    shades = ui.canvas._floats(camera, replace(app.settings, mode="depth"))[..., 0]
    opacity = ui.canvas._floats(camera, replace(app.settings, mode="alpha"))[..., 0]
    y, x = np.argwhere(opacity > 0.999)[::400].T
    distances = np.array(
        [ui.canvas.distance_at(camera, app.settings, a + 0.5, b + 0.5) for a, b in zip(x, y, strict=True)]
    )
    by_legend = near + (1 - shades[y, x] / opacity[y, x]) * (far - near)  # white is near
    assert len(x) > 20 and np.abs(by_legend - distances).max() < 0.02
    assert float(told.middle) == pytest.approx((near + far) / 2, abs=0.01) and "units" in told.unit


def test_depths_of_a_contracted_pack_are_told_as_far_as_the_inner_cube(ui, app, pack_folder):
    app.show(surroundings_pack(64), pack_folder)
    app.set(mode="depth")
    ui.settle()
    told, camera = display_panel.legend_of(app), app.camera()
    assert told.high.startswith("≥ ")
    distances = [ui.canvas.distance_at(camera, app.settings, x, 20.5) for x in (10.5, 200.5, 400.5)]
    assert all(distance > float(told.high[2:]) for distance in distances)  # the sky


@pytest.mark.parametrize("mode", ["samples", "jumps"])
def test_the_costs_have_a_scale_that_follows_the_slider(ui, app, mode):
    app.set(mode=mode, cost_scale=32.0)
    told = display_panel.legend_of(app)
    assert (told.low, told.middle, told.high) == ("0", "16", "≥ 32") and "ray" in told.unit
    counted = ui.canvas.ray_counts(app.camera(), replace(app.settings, mode="normal", counts=True))
    shown = ui.canvas._floats(app.camera(), app.settings)
    count = counted[..., 0 if mode == "samples" else 1]
    stops = np.array(told.stops)
    x = np.clip(count / 32.0, 0, 1) * (len(stops) - 1)
    wanted = np.stack([np.interp(x, np.arange(len(stops)), stops[:, i]) for i in range(3)], axis=-1)
    assert count.max() > 3 and np.abs(shown - wanted).mean() < 2e-3


def test_only_depth_and_costs_have_a_legend_and_it_is_seen(ui, app):
    for mode in MODES:
        app.set(mode=mode)
        assert (display_panel.legend_of(app) is not None) == (mode in ("depth", "samples", "jumps"))
    app.set(mode="depth")
    ui.settle()
    with_it = ui.picture().astype(int)
    box = app.viewport
    corner = with_it[round(box.y + box.height) - 90 : round(box.y + box.height) - 14, 20:230]
    assert (corner.max(axis=(1, 2)) > 240).any()  # the bar's white end
    ramp = corner[np.argmax(corner[:, 8:200].sum(axis=(1, 2)))][8:200, 0]
    assert ramp[0] > 230 and ramp[-1] < 40 and (np.diff(ramp) <= 3).all()


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


def test_two_packs_are_named_and_long_names_are_cut_at_the_edge(ui, app):
    app.compare_with(toy_pack(view_mlp=False), Path("scenes/toy-diffuse-with-a-very-long-name-indeed/pack"))
    assert app.comparison.sides(app) == ("toy", "toy-diffuse-with-a-very-long-name-indeed")
    app.comparison.split = 0.9
    app.touch()
    ui.settle()
    picture = ui.picture()
    edge, right = round(0.9 * app.viewport.width), round(app.viewport.width)
    row = round(app.viewport.y) + 27
    beyond = picture[row - 8 : row + 8, right + 4 : right + 10].astype(int)
    assert beyond.max() < 60  # nothing of it lies on the page beside the picture
    assert (picture[row, edge + 4 : right].astype(int).max(axis=1) > 240).any()  # nor does it fill all of its side
