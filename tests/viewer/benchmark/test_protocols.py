"""The orbit of snerg-bench is the paper's: at the distance of its photographs, about the origin of the scene."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from scenepack import Pack, save_pack
from tests.scenepack.random_packs import BLENDER_FRAME
from tests.viewer.commands.test_commands import benched
from viewer.benchmark.protocols import PROTOCOLS, flight, protocol_for
from viewer.commands import bench
from viewer.rendering.camera import content_box, orbit_path


@pytest.fixture(scope="module")
def aside(shapes: Pack) -> Pack:
    """Content of one unit beside the origin, in the frame of Blender scenes."""
    frame = BLENDER_FRAME.copy()
    frame[:3, 3] = [0.2, -0.1, 0.3]
    size = np.array(shapes.grid_size) * shapes.voxel_size
    return dataclasses.replace(shapes, min_xyz=np.array([0.2, 0.1, 0.3]) - 0.25 * size, worldspace_T_opengl=frame,
                               voxel_size=0.5 * shapes.voxel_size)  # fmt: skip


def test_cameras_stand_where_those_of_nerf_synthetic_stand_wherever_the_content_lies(aside: Pack) -> None:
    flown = flight(aside, "synthetic", 8)
    assert flown.facts == {
        "protocol": "synthetic", "fov": 39.0, "width": 800, "height": 800, "distance": 4.0311, "distance_from": "paper",
    }  # fmt: skip
    for camera in flown.cameras:
        world_T_camera = aside.worldspace_T_opengl @ camera.grid_T_camera
        eye, forward = world_T_camera[:3, 3], -world_T_camera[:3, 2]
        assert np.linalg.norm(eye) == pytest.approx(4.0311)
        np.testing.assert_allclose(forward, -eye / 4.0311, atol=1e-9)
        assert eye[2] == pytest.approx(4.0311 * 0.5)  # z is up in Blender
    assert not np.allclose(flown.cameras[0].position, flown.cameras[4].position)


def test_what_does_not_lie_within_the_papers_orbit_is_flown_around_as_before(aside: Pack) -> None:
    large = dataclasses.replace(aside, voxel_size=8 * aside.voxel_size)
    flown = flight(large, "synthetic", 4)
    assert flown.facts["distance_from"] == "content"
    middle = 0.5 * np.sum(content_box(large), axis=0)
    assert np.linalg.norm(flown.cameras[0].position - middle) == pytest.approx(flown.facts["distance"])
    for mine, fitted in zip(flown.cameras, orbit_path(large, 4), strict=True):
        np.testing.assert_array_equal(mine.grid_T_camera, fitted.grid_T_camera)
    assert flight(large, "synthetic", 4, distance="paper").facts["distance"] == 4.0311
    given = flight(aside, "synthetic", 4, distance="2.5")
    assert (given.facts["distance"], given.facts["distance_from"]) == (2.5, "given")


def test_a_scene_that_was_spherified_is_flown_around_as_the_papers_real_ones(aside: Pack, ndc_shapes: Pack) -> None:
    real = aside.with_metadata(provenance={"spherify": True})
    assert protocol_for(real) == "real360" and protocol_for(aside) == "synthetic"
    assert flight(real, "real360", 1, distance="paper").facts["distance"] == PROTOCOLS["real360"].distance == 1.0
    large = dataclasses.replace(aside, voxel_size=8 * aside.voxel_size)
    unbounded = large.with_metadata(contraction=float(2 * large.voxel_size))
    assert protocol_for(unbounded) == "real360"
    # within the surroundings, where its photographs were taken
    assert flight(unbounded, "real360", 1).facts["distance"] == 1.0
    assert protocol_for(ndc_shapes) == "forward-facing"
    assert flight(ndc_shapes, "forward-facing", 2).facts["distance"] is None


def test_the_json_says_which_distance(aside: Pack, tmp_path: Path, capsys, refused) -> None:
    save_pack(aside, tmp_path / "pack")
    words = [tmp_path / "pack", tmp_path / "bench.json", "--frames", 1]
    for extra, distance, of in (([], 4.0311, "paper"), (["--distance", "3"], 3.0, "given")):
        told_by = benched(*words, *extra)
        assert (told_by["distance"], told_by["distance_from"]) == (distance, of)
        assert f"orbit at {distance:.4g}" in capsys.readouterr().out
    assert "--distance" in refused(bench.main, words[0], "--distance", "far")
