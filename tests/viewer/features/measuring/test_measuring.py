"""Measuring: on scenes of known sizes, points and lengths are what the sizes say, to a fraction of a voxel."""

import itertools
from dataclasses import replace
from math import dist
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from tests.scenepack.volumes import cube_pack
from tests.viewer.conftest import toy_pack
from viewer.core.pose import Pose, project
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.measuring.surface import surface_at
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

SIDE, BLOCK = 64, 14
VOXEL = 2.0 / SIDE


def test_crop_and_near_plane_hide_what_they_hide_in_the_picture() -> None:
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    rgba[17:47, 9:31, 11:52] = (160, 90, 60, 255)
    block = cube_pack(rgba, BLOCK)
    camera = ViewCamera.look_at((0.0, 0.0, 4.0), (0.0, -0.4, 0.0), size=(800, 600))
    hit = surface_at(block, camera, RenderSettings(), 400.0, 300.0)
    assert hit is not None and abs(hit.point[2] - (-1.0 + VOXEL * 47)) < 0.2 * VOXEL
    cut = RenderSettings(crop=((-1.0, -1.0, -1.0), (1.0, 1.0, 0.1)))
    hit = surface_at(block, camera, cut, 400.0, 300.0)
    assert hit is not None and abs(hit.point[2] - 0.1) < 0.6 * VOXEL
    hit = surface_at(block, camera, RenderSettings(near=4.2), 400.0, 300.0)
    assert hit is not None and hit.distance >= 4.2 - 1e-9
    assert surface_at(block, camera, RenderSettings(near=9.0), 400.0, 300.0) is None


@pytest.mark.parametrize("ndc", [False, True])
def test_there_is_a_surface_where_the_renderer_draws_something(ctx, ndc: bool) -> None:
    pack = toy_pack(ndc=ndc, view_mlp=False)
    camera = orbit_camera_for(pack).camera((96, 72))
    with OffscreenRenderer(pack, ctx=ctx) as renderer:
        alpha = renderer.render_float(camera, RenderSettings(mode="alpha"))[..., 0]
    met = 0
    for y, x in itertools.product(range(2, 72, 7), range(2, 96, 7)):
        hit = surface_at(pack, camera, RenderSettings(), x + 0.5, y + 0.5)
        if alpha[y, x] > 0.98 or alpha[y, x] < 0.02:
            assert (hit is not None) == (alpha[y, x] > 0.5)
        if hit is not None:
            met += 1
            assert np.allclose(project(camera, hit.point[None])[0][0], (x + 0.5, y + 0.5), atol=1e-3)
    assert met > 10


def test_a_forward_facing_point_is_found_again_from_elsewhere() -> None:
    pack = toy_pack(ndc=True, view_mlp=False)
    rig = orbit_camera_for(pack)
    camera = rig.camera((400, 300))
    hit = surface_at(pack, camera, RenderSettings(), 190.0, 170.0)
    assert hit is not None
    moved = camera.grid_T_camera.copy()
    moved[:3, 3] += (0.05, 0.02, 0.0)
    other = replace(camera, grid_T_camera=moved)
    (x, y), (ahead,) = project(other, hit.point[None])[0][0], project(other, hit.point[None])[1]
    again = surface_at(pack, other, RenderSettings(), float(x), float(y))
    assert ahead and again is not None
    assert np.linalg.norm(again.point - hit.point) < 0.1 * hit.distance


TILE = 8  # voxels
FLOOR, WALL = 20, 12  # voxels: the floor's upper face and the wall's front
TILES = [  # corners of tiles, voxels: on the floor and on the wall
    ((16, FLOOR, 24), (48, FLOOR, 24)),
    ((16, FLOOR, 24), (16, FLOOR, 48)),
    ((16, FLOOR, 48), (48, FLOOR, 24)),
    ((24, 28, WALL), (24, 52, WALL)),
    ((16, 28, WALL), (48, 44, WALL)),
    ((16, 44, WALL), (48, FLOOR, 40)),
]


CORNERS = [(16, 28, WALL), (48, 28, WALL), (48, 44, WALL)]  # of a right angle on the wall


def seen_at(ui, *voxel: int) -> tuple[float, float]:
    """Where a corner of voxels is in the window."""
    return ui.place_of(-1.0 + VOXEL * np.array(voxel))


@pytest.fixture
def ui(offscreen, app):
    """A floor and a wall with tiles of TILE voxels in two colours, seen from before the wall, and the ruler in hand."""
    z, y, x = np.mgrid[:SIDE, :SIDE, :SIDE]
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    dark = (x // TILE + (y + 4) // TILE + z // TILE) % 2 == 0
    solid = (y < FLOOR) | (z < WALL)
    rgba[solid & dark], rgba[solid & ~dark] = (70, 80, 90, 255), (210, 200, 180, 255)
    ui = offscreen(app, cube_pack(rgba, BLOCK), Path("tiles"), size=(1280, 800))
    look_from(ui, 0, 20)
    app.run("measure")
    return ui


def look_from(ui, azimuth: float, elevation: float) -> None:
    rig = ui.app.scene.rig
    rig.goal = rig.shown = Pose((0.0, -0.4, 0.0), azimuth, elevation, 5.0)
    ui.settle()


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 40), (35, 25)])
def test_lengths_between_known_corners_are_right_to_half_a_voxel(ui, app, azimuth, elevation):
    look_from(ui, azimuth, elevation)
    assert app.measure_tool.tool == "line" and app.interface.page == "measure"
    for ends in TILES:
        for voxel in ends:
            ui.click(*seen_at(ui, *voxel))
        ui.key(imgui.Key.enter)
    measurements = app.annotations.current.measurements
    assert [len(m.points) for m in measurements] == [2] * len(TILES)
    for measurement, (a, b) in zip(measurements, TILES, strict=True):
        assert abs(dist(*measurement.points) / VOXEL - dist(a, b)) < 0.5, (a, b)


def test_a_double_click_ends_a_line_and_an_angle_ends_by_itself(ui, app):
    pivot = app.scene.rig.goal.pivot
    for corner in (*CORNERS, CORNERS[-1]):
        ui.click(*seen_at(ui, *corner))  # the last so soon that it is a double click
    (line,) = app.annotations.current.measurements
    assert len(line.points) == 3 and app.scene.rig.goal.pivot == pivot
    assert not app.measure_tool.draft
    ui.key(imgui.Key.mod_ctrl, imgui.Key.mod_shift, imgui.Key.c)
    assert app.clipboard.text.startswith("line 1: ")
    (x, y), goal = ui.place_of(line.points[0]), app.scene.rig.goal
    ui.drag([(x, y), (x, y - 12), (x, y - 25)])
    assert app.annotations.current.measurements[0].points[0] != line.points[0] and app.scene.rig.goal == goal
    app.run("undo")
    assert app.annotations.current.measurements == (line,)
    app.measure_tool.choose(app, "angle")
    for corner in CORNERS:
        ui.click(*seen_at(ui, *corner))
    turn = app.annotations.current.measurements[1]
    assert turn.kind == "angle" and not app.measure_tool.draft
    words = app.measure_tool.length_format(app)
    assert abs(float(words.measurement(turn)[:-1]) - 90.0) < 2.0


@pytest.mark.parametrize("way", [(0.0, 0.0), (0.0, -25.0)])
@pytest.mark.parametrize("meanwhile", ["undo", "another scene"])
def test_a_point_that_goes_away_under_the_mouse_button_is_let_go(ui, app, meanwhile, way):
    for corner in CORNERS[:2]:
        ui.click(*seen_at(ui, *corner))
    ui.key(imgui.Key.enter)
    line = app.annotations.current
    x, y = seen_at(ui, *CORNERS[0])
    ui.io.add_mouse_pos_event(x, y)
    ui.frames(2)
    ui.io.add_mouse_button_event(0, True)
    ui.frame()
    if meanwhile == "undo":
        app.run("undo")
    else:
        app.show(app.open_scene.pack, Path("same"))
        app.annotations.current = line
    kept, app.measure_tool.selected = app.annotations.current, None
    ui.io.add_mouse_pos_event(x + way[0], y + way[1])
    ui.frame()
    ui.io.add_mouse_button_event(0, False)
    ui.frames(2)
    assert app.annotations.current == kept and app.measure_tool.selected is None and not app.messages.dialogs


def test_backspace_takes_points_back_escape_stops_and_undo_brings_back(ui, app):
    for corner in CORNERS[:2]:
        ui.click(*seen_at(ui, *corner))
    ui.key(imgui.Key.backspace)
    assert len(app.measure_tool.draft) == 1
    ui.key(imgui.Key.mod_ctrl, imgui.Key.z)
    assert len(app.measure_tool.draft) == 2
    ui.key(imgui.Key.enter)
    assert len(app.annotations.current.measurements) == 1 and app.measure_tool.selected == 0
    ui.key(imgui.Key.delete)
    assert not app.annotations.current.measurements
    ui.key(imgui.Key.mod_ctrl, imgui.Key.z)
    assert len(app.annotations.current.measurements) == 1
    ui.click(*seen_at(ui, *CORNERS[2]))
    ui.key(imgui.Key.escape)
    assert not app.measure_tool.draft and app.measure_tool.tool == "line"
    ui.key(imgui.Key.escape)
    assert not app.measure_tool.tool and app.interface.page == "measure"


def test_a_known_distance_gives_lengths_a_unit(ui, app):
    ui.press("Set by two points")
    for corner in CORNERS[:2]:
        ui.click(*seen_at(ui, *corner))
    ui.frames(2)
    ui.io.add_input_characters_utf8("6.4")  # the field has the keyboard
    ui.frame()
    ui.key(imgui.Key.enter)
    scale = app.annotations.current.scale
    assert scale.unit == "m" and abs(scale.factor * 32 * VOXEL - 6.4) < 6.4 * 0.5 / 32
    assert app.measure_tool.tool == "line"
    annotations = app.annotations.current
    app.annotations.change(app, replace(annotations, scale=annotations.scale.shown_in("ft")))
    assert abs(app.annotations.current.scale.factor * 32 * VOXEL - 6.4 / 0.3048) < 21 * 0.5 / 32
    app.run("undo")
    assert app.annotations.current.scale.unit == "m"
