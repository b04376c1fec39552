"""Where rays begin: one rule for the field, and for the pruning, the tuning and the evaluation of its packs.

Notation: a speck hangs before the first camera, nearer than `near`, and hides an opaque ball from it.
"""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from baker.reports.evaluation import evaluate, shown_by
from baker.tuning.pruning import arriving_transmittance, prune
from scenepack import Pack, save_pack
from scenepack.blocks import dense_from_pack
from tests.baker.analytic import RADIUS
from tests.scenepack.random_packs import BLENDER_FRAME
from tests.scenepack.volumes import atlas_from_dense
from training.config import QUICK
from training.dataset import RayDataset, make_dataset
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
def seen(alone: Scene) -> RayDataset:
    return make_dataset(alone)


def camera_of(alone: Scene) -> Camera:
    return alone.splits["train"][0].camera


def speck_at(alone: Scene, points: np.ndarray) -> np.ndarray:
    """bool [...]: which of the points [..., 3], training frame, lie within the speck."""
    eye = camera_of(alone).world_T_camera[:3, 3]
    return np.linalg.norm(points - SPECK * eye / np.linalg.norm(eye), axis=-1) < SPECK_RADIUS


def ball_pack(alone: Scene, speck: bool) -> tuple[Pack, np.ndarray]:
    """The ball as a pack that knows where its rays begin, and which of its voxels [z, y, x] are the speck's."""
    voxel = 3.0 / SIDE
    at = np.stack(np.meshgrid(*[(np.arange(SIDE) + 0.5) * voxel - 1.5] * 3, indexing="ij")[::-1], axis=-1)
    inside = speck_at(alone, at @ BLENDER_FRAME[:3, :3].T)
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    rgba[np.linalg.norm(at, axis=-1) < RADIUS] = (200, 100, 50, 255)
    if speck:
        rgba[inside] = (0, 0, 255, 255)
    atlas = atlas_from_dense(rgba, np.zeros_like(rgba), BLOCK)
    pack = Pack(voxel, np.full(3, -1.5), (SIDE, SIDE, SIDE), BLOCK, *atlas, None, BLENDER_FRAME)
    return pack.with_metadata(near=NEAR), inside


def hides_the_ball(pictures: list[np.ndarray]) -> bool:
    """Whether any of the pictures of ball and speck [2] differ anywhere."""
    return bool(np.abs(pictures[0] - pictures[1]).max() > 0.2)


def test_the_field_is_drawn_without_what_is_nearer_than_near(alone: Scene, seen: RayDataset) -> None:
    multires = MultiresConfig(resolutions=(16,), occupancy=32, steps_across=(64, 64, 64))
    method = MultiresMethod(replace(QUICK, engine="fused", multires=multires), seen)
    state = method.start(jax.random.key(0))
    state.box = Box(np.full(3, -1.5), np.full(3, 3.0 / 32), np.full(3, 32, np.int32))
    cells = (np.stack(np.indices((32,) * 3)[::-1], -1) + 0.5) * 3 / 32 - 1.5
    vertices = np.stack(np.indices((17,) * 3)[::-1], -1) * 3 / 16 - 1.5
    ball, speck = np.linalg.norm(cells, axis=-1) < RADIUS, speck_at(alone, cells)
    assert ball.any() and speck.any()
    table, parameters = np.zeros_like(state.values.table), np.zeros_like(state.values.parameters)
    table[: 17**3, 0] = (np.linalg.norm(vertices, axis=-1) > 1.2 * RADIUS).ravel()  # the speck's colour
    inputs = inputs_of(1)
    w1, b1 = inputs * HIDDEN + HIDDEN, decoder_size(inputs) - 8
    parameters[0], parameters[w1 + 1 : w1 + 4], parameters[b1 : b1 + 4] = 1.0, -6.0, (8.0, 3.0, 3.0, 3.0)
    state.values = Trainable(table, parameters)
    rays = seen.view_rays(camera_of(alone))
    from_zero = rays._replace(near=jnp.zeros_like(rays.near))
    shown: dict[str, list[np.ndarray]] = {"near": [], "zero": []}
    for opaque in (ball | speck, ball):
        state.codes = np.where(opaque, INITIAL, NEVER).astype(np.uint8)
        for name, some in (("near", rays), ("zero", from_zero)):
            shown[name].append(np.asarray(method.render(state, some).rgb))
    assert not hides_the_ball(shown["near"]) and hides_the_ball(shown["zero"])


def test_the_pack_is_drawn_and_scored_as_its_field_is(alone: Scene, tmp_path: Path) -> None:
    pictures, scores = [], []
    for speck in (True, False):
        save_pack(ball_pack(alone, speck)[0], tmp_path / f"{speck}")
        with shown_by(tmp_path / f"{speck}") as drawn:
            pictures.append(drawn.show(camera_of(alone), "normal"))
        scores.append(evaluate(tmp_path / f"{speck}", alone, "train")["psnr"])
    assert not hides_the_ball(pictures) and scores[0] == pytest.approx(scores[1], abs=1e-6)
    save_pack(ball_pack(alone, True)[0].with_metadata(near=0.0), tmp_path / "anywhere")
    with shown_by(tmp_path / "anywhere") as drawn:
        assert hides_the_ball([drawn.show(camera_of(alone), "normal"), pictures[1]]), "as a pack that does not say"


def test_pruning_empties_what_is_nearer_than_near_to_all_who_could_see_it(alone: Scene, seen: RayDataset) -> None:
    pack, speck = ball_pack(alone, True)
    before = dense_from_pack(pack)[0][..., 3] > 0
    light = arriving_transmittance(pack, seen, 0)
    assert light is not None
    stays = dense_from_pack(prune(pack, light, lambda pack: 0.0, most_lost=1.0)[0])[0][..., 3] > 0
    assert before[speck].all() and not stays[speck].any()
    assert stays[before & ~speck].sum() > 0.1 * before.sum(), "the ball behind it is seen and stays"


@pytest.mark.parametrize("near", ["0.5", True, -1.0, np.nan, np.inf, None, [1.0], pytest.param(10**400, id="huge")])
def test_a_pack_that_says_nonsense_begins_at_the_camera(alone: Scene, near: object) -> None:
    pack = ball_pack(alone, False)[0]
    assert pack.near == NEAR and pack.with_metadata(near=near).near == 0.0
