"""Where rays begin: one rule for the field, and for the evaluation of its packs. For pruning and tuning: tuning/test_marcher.py.

Notation: a speck hangs before the first camera, nearer than `near`, and hides an opaque ball from it.
"""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from baker.reports.evaluation import evaluate, shown_by
from scenepack import Pack, save_pack
from tests.baker.analytic import RADIUS
from tests.scenepack.helpers import small_pack
from tests.scenepack.volumes import BLENDER_FRAME, cube_pack
from training.config import QUICK
from training.dataset import make_dataset
from training.multires.config import MultiresConfig
from training.multires.field import HIDDEN, decoder_size, inputs_of
from training.multires.method import MultiresMethod
from training.multires.occupancy import INITIAL, NEVER
from training.multires.state import Box, Trainable
from training.scenes import Camera, Scene

SIDE, BLOCK = 42, 14
# cameras stand 4.03 from the origin; the speck is SPECK from it, towards the first
NEAR, SPECK, SPECK_RADIUS = 3.05, 1.4, 0.2


@pytest.fixture(scope="module")
def alone(scene: Scene) -> Scene:
    """One photograph, of a scene that begins behind the speck."""
    return replace(scene, near=NEAR, splits={"train": scene.splits["train"][:1]})


@pytest.fixture(scope="module")
def camera(alone: Scene) -> Camera:
    return alone.splits["train"][0].camera


def in_speck(camera: Camera, points: np.ndarray) -> np.ndarray:
    """bool [...]: which of the points [..., 3], training frame, lie within the speck."""
    eye = camera.world_T_camera[:3, 3]
    return np.linalg.norm(points - SPECK * eye / np.linalg.norm(eye), axis=-1) < SPECK_RADIUS


def ball_pack(camera: Camera, speck: bool) -> Pack:
    """The ball as a pack that knows where its rays begin."""
    voxel = 3.0 / SIDE
    at = np.stack(np.meshgrid(*[(np.arange(SIDE) + 0.5) * voxel - 1.5] * 3, indexing="ij")[::-1], axis=-1)
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    rgba[np.linalg.norm(at, axis=-1) < RADIUS] = (200, 100, 50, 255)
    if speck:
        rgba[in_speck(camera, at @ BLENDER_FRAME[:3, :3].T)] = (0, 0, 255, 255)
    pack = cube_pack(rgba, BLOCK, features=np.zeros_like(rgba))
    return replace(pack, voxel_size=voxel, min_xyz=np.full(3, -1.5)).with_metadata(near=NEAR)


def test_the_field_is_drawn_without_what_is_nearer_than_near(alone: Scene, camera: Camera) -> None:
    seen = make_dataset(alone)
    multires = MultiresConfig(resolutions=(16,), occupancy=32, steps_across=(64, 64, 64))
    method = MultiresMethod(replace(QUICK, engine="fused", multires=multires), seen)
    state = method.start(jax.random.key(0))
    state.box = Box(np.full(3, -1.5), np.full(3, 3.0 / 32), np.full(3, 32, np.int32))
    cells = (np.moveaxis(np.indices((32,) * 3)[::-1], 0, -1) + 0.5) * 3 / 32 - 1.5
    vertices = np.moveaxis(np.indices((17,) * 3)[::-1], 0, -1) * 3 / 16 - 1.5
    ball, speck = np.linalg.norm(cells, axis=-1) < RADIUS, in_speck(camera, cells)
    assert ball.any() and speck.any()
    table, parameters = np.zeros_like(state.values.table), np.zeros_like(state.values.parameters)
    table[: 17**3, 0] = (np.linalg.norm(vertices, axis=-1) > 1.2 * RADIUS).ravel()  # the speck's colour
    inputs = inputs_of(1)
    w1, b1 = inputs * HIDDEN + HIDDEN, decoder_size(inputs) - 8
    parameters[0], parameters[w1 + 1 : w1 + 4], parameters[b1 : b1 + 4] = 1.0, -6.0, (8.0, 3.0, 3.0, 3.0)
    state.values = Trainable(table, parameters)
    rays = seen.view_rays(camera)
    from_zero = rays._replace(near=jnp.zeros_like(rays.near))
    shown: dict[str, list[np.ndarray]] = {"near": [], "zero": []}
    for opaque in (ball | speck, ball):
        state.codes = np.where(opaque, INITIAL, NEVER).astype(np.uint8)
        for name, some in (("near", rays), ("zero", from_zero)):
            shown[name].append(np.asarray(method.render(state, some).rgb))
    near, zero = (np.abs(with_speck - without).max() for with_speck, without in shown.values())
    assert near < 0.2 < zero


def test_a_pack_is_drawn_and_scored_as_its_field_is(alone: Scene, camera: Camera, tmp_path: Path) -> None:
    ball, hidden = (ball_pack(camera, speck) for speck in (False, True))
    pictures, scores = [], []
    for name, pack in (("ball", ball), ("hidden", hidden), ("anywhere", hidden.with_metadata(near=0.0))):
        save_pack(pack, tmp_path / name)
        with shown_by(tmp_path / name) as drawn:
            pictures.append(drawn.show(camera, "normal"))
        scores.append(evaluate(tmp_path / name, alone, "train")["psnr"])
    differences = [np.abs(picture - pictures[0]).max() for picture in pictures]
    assert differences[1] < 0.2 < differences[2] and scores[0] == pytest.approx(scores[1], abs=1e-6)


@pytest.mark.parametrize("near", ["0.5", True, -1.0, np.nan, np.inf, None, [1.0], pytest.param(10**400, id="huge")])
def test_a_pack_that_says_nonsense_begins_at_the_camera(near: object) -> None:
    pack = small_pack().with_metadata(near=NEAR)
    assert pack.near == NEAR and pack.with_metadata(near=near).near == 0.0
