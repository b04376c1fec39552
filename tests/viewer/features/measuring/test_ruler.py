"""The ruler in the picture: clicks measure between known corners, and what was measured can be moved, removed and undone."""

from math import dist
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from scenepack import Pack
from tests.scenepack.volumes import cube_pack
from tests.viewer.features.measuring.test_surface import BLOCK, SIDE, VOXEL, block_pack
from tests.viewer.features.measuring.test_surface import corner as known_corner
from viewer.core.pose import Pose, triple

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


def tiled_pack() -> Pack:
    """A floor and a wall with tiles of TILE voxels in two colours, in the box of -1 … 1."""
    z, y, x = np.mgrid[:SIDE, :SIDE, :SIDE]
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    dark = (x // TILE + (y + 4) // TILE + z // TILE) % 2 == 0
    solid = (y < FLOOR) | (z < WALL)
    rgba[solid & dark], rgba[solid & ~dark] = (70, 80, 90, 255), (210, 200, 180, 255)
    return cube_pack(rgba, BLOCK)


AIM = 0.2  # voxels: a person points just inside of an edge, not beside it


def corner(*high: int) -> np.ndarray:
    """A corner of the block's front as one aims at it, in the plane of that face."""
    middle = 0.5 * (known_corner(0, 0, 0) + known_corner(1, 1, 1))
    exact = known_corner(*high)
    return exact + AIM * VOXEL * np.sign(middle - exact) * (1, 1, 0)


@pytest.fixture
def ui(offscreen, app):
    return offscreen(app, block_pack(), Path("block"), size=(1280, 800))


def look_from(ui, azimuth: float, elevation: float, distance: float = 3.0) -> None:
    rig = ui.app.scene.rig
    rig.goal = rig.shown = Pose(triple(0.5 * (corner(0, 0, 0) + corner(1, 1, 1))), azimuth, elevation, distance)
    ui.settle()


@pytest.mark.parametrize(("azimuth", "elevation"), [(0, 40), (35, 25)])
def test_lengths_between_known_corners_are_right_to_half_a_voxel(ui, app, azimuth, elevation):
    app.show(tiled_pack(), Path("tiles"))
    app.run("measure")
    look_from(ui, azimuth, elevation, 5.0)
    assert app.measure_tool.tool == "line" and app.interface.page == "measure"
    for ends in TILES:
        for voxel in ends:
            ui.click(*ui.place_of(-1.0 + VOXEL * np.array(voxel)))
        ui.key(imgui.Key.enter)
    measurements = app.annotations.current.measurements
    assert [len(m.points) for m in measurements] == [2] * len(TILES)
    for measurement, (a, b) in zip(measurements, TILES, strict=True):
        assert abs(dist(*measurement.points) / VOXEL - dist(a, b)) < 0.5, (a, b)


def test_a_double_click_ends_a_line_and_an_angle_ends_by_itself(ui, app):
    look_from(ui, 0, 0)
    app.run("measure")
    pivot = app.scene.rig.goal.pivot
    corners = [corner(0, 0, 1), corner(1, 0, 1), corner(1, 1, 1)]
    for point in corners:
        ui.click(*ui.place_of(point))
    ui.click(*ui.place_of(corners[-1]))  # so soon that the two are one double click
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
    for point in corners:
        ui.click(*ui.place_of(point))
    turn = app.annotations.current.measurements[1]
    assert turn.kind == "angle" and not app.measure_tool.draft
    words = app.measure_tool.length_format(app)
    assert abs(float(words.measurement(turn)[:-1]) - 90.0) < 2.0


def test_backspace_takes_points_back_escape_stops_and_undo_brings_back(ui, app):
    look_from(ui, 0, 0)
    app.run("measure")
    for point in (corner(0, 0, 1), corner(1, 0, 1)):
        ui.click(*ui.place_of(point))
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
    ui.click(*ui.place_of(corner(1, 1, 1)))
    ui.key(imgui.Key.escape)
    assert not app.measure_tool.draft and app.measure_tool.tool == "line"
    ui.key(imgui.Key.escape)
    assert not app.measure_tool.tool and app.interface.page == "measure"


def test_a_known_distance_gives_lengths_a_unit(ui, app):
    look_from(ui, 0, 0)
    app.interface.page = "measure"
    ui.press("Set by two points")
    for point in (corner(0, 0, 1), corner(1, 0, 1)):
        ui.click(*ui.place_of(point))
    ui.press("##known")
    ui.key(imgui.Key.mod_ctrl, imgui.Key.a)
    ui.io.add_input_characters_utf8("8.2")
    ui.frame()
    ui.press("Set the scale")
    scale = app.annotations.current.scale
    assert scale.unit == "m" and abs(scale.factor * 41 * VOXEL - 8.2) < 8.2 * 0.5 / 41
    assert app.measure_tool.tool == "line"
    app.measure_tool.use_scale(app, app.annotations.current.scale.shown_in("ft"))
    assert abs(app.annotations.current.scale.factor * 41 * VOXEL - 8.2 / 0.3048) < 27 * 0.5 / 41
    app.run("undo")
    assert app.annotations.current.scale.unit == "m"
