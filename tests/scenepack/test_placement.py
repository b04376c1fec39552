"""The placed frame: rotations, what is written of it, the ground that is found, and exports in it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from console import UserError
from scenepack import Pack
from scenepack.exports.field import ExportFrame, Field
from scenepack.exports.file_formats import gaussian_values, voxels_of
from scenepack.exports.scene import Export, geometry_of
from scenepack.placement import (
    NOT_MOVED,
    ground_plane,
    moved_pose,
    placed_T_grid,
    placement_from_json,
    placement_of,
    placement_to_json,
)
from tests.scenepack.volumes import centres, cube_pack, solid_pack
from tests.viewer.scenes import with_cameras
from viewer.rendering.camera import ViewCamera

SIDE, BLOCK, SLOPE = 60, 15, 0.25
UP = np.array([-SLOPE, 1.0, 0.0]) / np.hypot(SLOPE, 1.0)
AT = np.array([0.0, -0.5, 0.0])  # on the slope, grid frame
ANGLES = st.tuples(st.floats(-180, 180), st.floats(-89, 89), st.floats(-180, 180))


def sloping_pack(**options) -> Pack:
    """A floor that rises towards +x by SLOPE, a wall across it and a ball, in the box of -1 … 1."""
    x, y, z = centres(SIDE)
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    height = y + 0.5 - SLOPE * x
    rgba[height < 0] = (90, 120, 80, 255)
    rgba[(height < 0.6) & (z < -0.8)] = (150, 60, 60, 255)
    rgba[(x - 0.3) ** 2 + (y - 0.1) ** 2 + z**2 < 0.04] = (60, 60, 200, 255)
    pack = cube_pack(rgba, BLOCK)
    return pack.with_metadata(**options) if options else pack


@given(ANGLES, st.tuples(*3 * [st.floats(-1, 1)]).filter(lambda up: np.linalg.norm(up) > 0.1))
def test_levelling_brings_any_direction_up_by_the_least_turn(angles, up) -> None:
    before = replace(NOT_MOVED.with_angles(*angles), origin=(0.3, -0.2, 0.7))
    at = np.array([1.0, 2.0, -3.0])
    after = before.levelled(np.array(up), at)
    assert np.allclose(after.up, np.array(up) / np.linalg.norm(up), atol=1e-9)
    assert np.isclose((after.matrix(2.5) @ [*at, 1.0])[1], 0.0, atol=1e-9)
    turn = np.array(after.rotation) @ np.array(before.rotation).T
    least = np.arccos(np.clip(before.up @ after.up, -1, 1))
    assert np.isclose(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)), least, atol=1e-6)


@given(ANGLES)
def test_angles_and_json_come_back(angles) -> None:
    placement = replace(NOT_MOVED.with_angles(*angles), origin=(1.0, -2.0, 0.5))
    assert np.allclose(NOT_MOVED.with_angles(*placement.angles).rotation, placement.rotation, atol=1e-9)
    again = placement_from_json(json.loads(json.dumps(placement_to_json(placement))))
    assert np.allclose(again.rotation, placement.rotation, atol=1e-12) and again.origin == placement.origin


@pytest.mark.parametrize(
    "value",
    [3, [], {"rotation": [[1, 0], [0, 1]]}, {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, {"rotation": "abc"},
     {"rotation": [[1, 0, 0], [0, 1], [0, 0, 1]]}, {"rotation": [[2, 0, 0], [0, 2, 0], [0, 0, 2]]}, {"origin": [1, 2]},
     {"origin": [1, 2, float("nan")]}, {"origin": [1, 2, 1e300]}, {"origin": [True, False, True]}],
)  # fmt: skip
def test_what_is_no_placement_is_refused_and_a_pack_that_says_it_is_not_moved(value) -> None:
    with pytest.raises(ValueError, match="placement"):
        placement_from_json(value)
    pack = sloping_pack(marks={"placement": value, "scale": {"factor": "long"}})
    assert placement_of(pack) == NOT_MOVED and np.array_equal(placed_T_grid(pack), np.eye(4))


def test_where_there_is_no_floor_none_is_found() -> None:
    inside = 0.6 - np.square(centres(SIDE)).sum(axis=0)
    for pack in (solid_pack(10 * inside, (255, 255, 255)), solid_pack(0 * inside - 1, (0, 0, 0))):
        with pytest.raises(UserError, match="no ground"):
            ground_plane(pack, np.array([0.0, 1.0, 0.0]))


MOVED = replace(NOT_MOVED.levelled(UP, AT), origin=(0.1, -0.4, 0.2))
MARKS = {"placement": placement_to_json(MOVED), "scale": {"factor": 2.5, "unit": "m"}}


def test_a_mesh_in_the_placed_frame_is_the_grids_mesh_moved_with_its_cameras() -> None:
    pack = with_cameras(sloping_pack(marks=MARKS), [ViewCamera.look_at((1.0, 2.0, 3.0), (0.1, 0.0, 0.2))])
    grid, placed = (geometry_of(pack, Export("mesh", frame=frame, faces=0)) for frame in ("grid", "placed"))
    moved = MOVED.matrix(2.5)
    assert np.allclose(placed.vertices, grid.vertices @ moved[:3, :3].T + moved[:3, 3], atol=1e-5)
    assert np.allclose(placed.normals, grid.normals @ np.array(MOVED.rotation).T, atol=1e-4)
    assert np.array_equal(placed.faces, grid.faces)
    # of glTF: by columns
    poses = [np.reshape(geometry.cameras[0][0]["matrix"], (4, 4)).T for geometry in (placed, grid)]
    assert np.allclose(poses[0], moved_pose(moved, poses[1]), atol=1e-9)


def test_gaussians_of_bent_space_turn_with_the_placed_frame(tmp_path: Path) -> None:
    marks = {"placement": placement_to_json(NOT_MOVED.with_angles(170.0, 40.0, 100.0))}
    pack = sloping_pack(marks=marks, contraction=0.4)
    field, frame = Field(pack), ExportFrame(pack, "placed")
    positions, rgba = voxels_of(field, 0.5)
    near = frame.near_enough(positions)
    values = gaussian_values(positions[near], rgba[near], field, frame)
    assert np.ptp(values[4], axis=1).max() > 0.1  # they are no balls
    w, x, y, z = values[5][0]
    assert np.allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), placement_of(pack).rotation, atol=1e-9)
