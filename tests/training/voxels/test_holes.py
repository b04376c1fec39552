"""Holes that no photograph shows are walled up before a view between photographs looks through them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from tests.training.voxels.test_fused import CONFIG, VOXELS
from training.dataset import RayDataset, make_dataset
from training.scenes import load_scene
from training.voxels.holes import attached, close_holes, holes_of
from training.voxels.method import VoxelMethod
from training.voxels.sparse_grid import CHANNELS, build_layout
from training.voxels.state import Trainable, state_over

SIDE, CELLS = 40, 48  # pixels of a photograph, voxels of the box
FLOOR, HOLE, SCREEN = 12, slice(21, 27), 30  # voxels: height of the floor, its hole, height of the screens above
AIM = (FLOOR + 1) / CELLS * 3 - 1.5  # z of the hole's middle
PALE = 2.0  # raw colour of the floor
LEFT, MIDDLE, RIGHT = -3.0, 0.0, 3.0  # x of the photographs, and of the view between


def pose_from(x: float) -> list[list[float]]:
    """A camera at (x, 0, 3) that looks at the hole's middle."""
    place, aim = np.array([x, 0.0, 3.0]), np.array([0.0, 0.0, AIM])
    back = (place - aim) / np.linalg.norm(place - aim)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, place], axis=1)
    return matrix.tolist()


@pytest.fixture(scope="module")
def two_photographs(tmp_path_factory: pytest.TempPathFactory) -> RayDataset:
    """Photographs from the left and the right."""
    folder = tmp_path_factory.mktemp("two")
    frames = [{"file_path": f"./{name}", "transform_matrix": pose_from(x)} for name, x in (("a", LEFT), ("b", RIGHT))]
    for split in ("train", "test"):
        (folder / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": 0.6, "frames": frames}))
    for name in ("a", "b"):
        Image.fromarray(np.full((SIDE, SIDE, 4), (200, 200, 200, 128), np.uint8)).save(folder / f"{name}.png")
    return make_dataset(load_scene(folder))


def floor_with_a_hole(method: VoxelMethod, dataset: RayDataset, hole: bool = True) -> Any:
    """A floor with a hole in its middle, and two screens: each hides the hole from one of the photographs."""
    present = np.zeros((CELLS,) * 3, bool)
    present[FLOOR : FLOOR + 2, 4:-4, 4:-4] = True
    if hole:
        present[FLOOR : FLOOR + 2, HOLE, HOLE] = False
    for side in (-1, 1):  # on the line from the hole to the photograph
        middle = 24 + side * round((SCREEN - FLOOR) * RIGHT / (3.0 - AIM))
        present[SCREEN, 18:30, middle - 5 : middle + 5] = True
    voxel = np.full(3, 3.0 / CELLS)
    layout = build_layout(present, np.full(3, -1.5), voxel)
    rows = np.zeros((np.count_nonzero(present) + 1, CHANNELS), np.float32)
    rows[1:, 0] = 400 * method.settings.reference  # opaque within a voxel
    rows[1:, 1:] = PALE
    parts = [Trainable(jnp.asarray(values), None) for values in (rows, np.zeros_like(rows), np.ones_like(rows))]
    return method.engine.begin(state_over(layout, (parts[0], parts[1], parts[2]), jnp.int32(7), dataset.count))


def method_of(dataset: RayDataset) -> VoxelMethod:
    voxels = dataclasses.replace(VOXELS, view_dependence=False)
    return VoxelMethod(dataclasses.replace(CONFIG, voxels=voxels), dataset)


def closed(method: VoxelMethod, state: Any, dataset: RayDataset) -> Any:
    return close_holes(method.engine, state, dataset, method.plan, method.settings)


def alphas(method: VoxelMethod, state: Any, dataset: RayDataset, x: float) -> np.ndarray:
    """Opacity of a picture from (x, 0, 3)."""
    camera = dataset_camera(dataset, x)
    return np.asarray(method.render(state, camera).alpha).reshape(SIDE, SIDE)


def dataset_camera(dataset: RayDataset, x: float) -> Any:
    from_there = dataclasses.replace(
        dataset, world_T_camera=jnp.asarray([np.array(pose_from(x))[:3]] * dataset.views, jnp.float32)
    )
    return from_there.geometry_at(jnp.arange(SIDE * SIDE))


def test_a_hole_that_both_photographs_miss_is_walled_up_in_the_floors_colours(two_photographs: RayDataset) -> None:
    method = method_of(two_photographs)
    state = floor_with_a_hole(method, two_photographs)
    centre = (slice(SIDE // 2 - 1, SIDE // 2 + 1),) * 2
    before = {x: alphas(method, state, two_photographs, x) for x in (LEFT, MIDDLE, RIGHT)}
    assert before[MIDDLE][centre].max() < 0.1, "a view between looks through it"
    assert before[LEFT][centre].min() > 0.9 and before[RIGHT][centre].min() > 0.9, "photographs do not"
    count = method.engine.occupancy(state).present.sum()
    state = closed(method, state, two_photographs)
    after = {x: alphas(method, state, two_photographs, x) for x in (LEFT, MIDDLE, RIGHT)}
    assert after[MIDDLE][centre].min() > 0.8
    for x in (LEFT, RIGHT):
        np.testing.assert_allclose(after[x], before[x], atol=0.02, err_msg="photographs see no wall")
    plain = method.engine.end(state)
    rows = np.asarray(plain.trainable.rows)
    assert plain.closed and method.engine.occupancy(state).present.sum() == len(rows) - 1 > count
    np.testing.assert_allclose(rows[1:, 1:], PALE, atol=1e-5, err_msg="the floor's colours")
    fresh = np.asarray(plain.second.rows)[1:, 0] == 0
    assert 0 < fresh.sum() <= len(rows) - 1 - count and np.asarray(plain.second.rows)[1:][~fresh].min() == 1
    assert int(plain.updates) == 7 and method.engine.drawn(state)[1] == two_photographs.count


def test_a_whole_floor_stays_as_it_is(two_photographs: RayDataset) -> None:
    method = method_of(two_photographs)
    state = floor_with_a_hole(method, two_photographs, hole=False)
    before = method.engine.end(state)
    again = method.engine.end(closed(method, state, two_photographs))
    assert again.closed and not before.closed
    np.testing.assert_array_equal(again.trainable.rows, before.trainable.rows)


def test_beside_known_emptiness_nothing_is_a_hole() -> None:
    meets = np.ones((9, 12), bool)
    meets[:, 8:] = False  # beside the silhouette: empty in columns 9 on, unknown in column 8
    meets[3:5, 3:5] = meets[7:, 2] = False  # amid the surface, and at the picture's edge
    enters = np.ones_like(meets)
    enters[:, 9:] = False
    expected = np.zeros_like(meets)
    expected[3:5, 3:5] = True
    np.testing.assert_array_equal(holes_of(meets, enters), expected)


def test_walls_that_touch_nothing_solid_are_none() -> None:
    walls, solid = np.zeros((2, 8, 8, 8), bool)
    solid[1, :, :] = True
    walls[2, 2:5, 2:5] = walls[3, 4, 4] = True
    assert attached(walls, solid).sum() == 10
    walls[6, 6, 1:3] = True
    assert attached(walls, solid).sum() == 10


def test_holes_are_closed_once_and_a_checkpoint_knows(procedural_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    method = method_of(make_dataset(load_scene(procedural_path)))
    method.config = dataclasses.replace(
        method.config, steps=10, voxels=dataclasses.replace(method.config.voxels, close_holes_from=0.5)
    )
    at: list[int] = []

    def close(engine: Any, state: Any, *_: Any) -> Any:
        at.append(step)
        return engine.begin(engine.end(state)._replace(closed=True))

    monkeypatch.setattr("training.voxels.method.close_holes", close)
    state = method.start(jax.random.key(0))
    for step in range(8):
        assert state.closed == (step > 5)
        state, _ = method.step(state, step)
        if step in (3, 6):
            state = method.restore(method.save(state))
    assert at == [5]
    method.config = dataclasses.replace(
        method.config, voxels=dataclasses.replace(method.config.voxels, close_holes_from=1.0)
    )
    method.step(method.start(jax.random.key(0)), 9)
    assert at == [5], "1 is never"
