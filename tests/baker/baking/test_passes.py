"""The passes over a bake's voxels: what each is given, and what it leaves to the next."""

from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baker.baking import bake as baking
from baker.baking import passes
from baker.baking.config import BakeConfig
from baker.baking.passes import passes_of, with_views_between
from console.progress import progress
from scenepack.blocks import dense_from_pack
from tests.scenepack.random_packs import random_pack
from tests.scenepack.volumes import features_of
from tests.stored_runs import SCENE, STORED
from training.dataset import RayDataset
from training.run import load_run


class HandedOver(Exception):
    """What a bake has come to."""


@pytest.mark.parametrize("preset", ["snerg", "paper"])
def test_what_tunes_compares_with_photographs_in_the_look_of_the_field(scene, dataset, monkeypatch, preset):
    gains = np.ones((dataset.views, 3), np.float32)
    gains[:, 0] = np.linspace(0.5, 1.5, dataset.views)
    seen: list[RayDataset] = []

    def tune(pack: Any, photographs: RayDataset, *_: Any, **__: Any) -> Any:
        seen.append(photographs)
        raise HandedOver

    method = SimpleNamespace(gains=lambda state: gains)
    run: Any = SimpleNamespace(method=method, dataset=dataset, scene=scene, state=0)
    monkeypatch.setattr(baking, "check_bake", lambda *_: None)
    monkeypatch.setattr(baking, "culled_grid", lambda *_: (None, None))
    monkeypatch.setattr(baking, "supersampled", lambda *_: random_pack(np.random.default_rng(0)))
    monkeypatch.setattr(passes, "arriving_transmittance", lambda *_: None)
    monkeypatch.setattr(passes, "fine_tune", tune)
    monkeypatch.setattr(passes, "joint_tune", tune)
    with pytest.raises(HandedOver):
        baking.bake(run, BakeConfig(preset=preset))
    ids = jnp.arange(0, dataset.count, 7)
    shown = np.asarray(dataset.in_average_look(gains).colours_at(ids))
    assert np.abs(shown - np.asarray(dataset.colours_at(ids))).max() > 0.1
    assert len(seen) == 1 and np.array_equal(np.asarray(seen[0].colours_at(ids)), shown)


def test_scaled_features_say_the_same_to_the_view_mlp(dataset: RayDataset) -> None:
    pack = random_pack(np.random.default_rng(0))
    values = features_of(pack).astype(float)
    with progress("", 1.0, quiet=True) as bar:
        scaled = passes.with_scaled_features(passes.Voxels(pack, dataset, BakeConfig()), bar).pack
    assert scaled.view_mlp is not None and pack.view_mlp is not None
    before, now = pack.view_mlp.weights[0], scaled.view_mlp.weights[0]
    assert features_of(scaled).max() <= 64 and np.array_equal(now[:-4], before[:-4])
    rounding = 0.5 * np.abs(now[-4:]).sum(axis=0) + 1e-3
    assert np.all(np.abs(features_of(scaled) @ now[-4:] - values @ before[-4:]) <= rounding)


def test_a_bake_says_how_it_was_made_and_of_the_papers_nothing_is_emptied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "MOST_LOST_PRUNED", 3.0)  # so coarse a grid of mist would keep all
    loaded = load_run(STORED / "multires", scene_path=SCENE)
    ours, papers = (baking.bake(loaded, BakeConfig(31, preset, "draft")) for preset in ("snerg", "paper"))
    made, literal = ours.metadata["provenance"], papers.metadata["provenance"]
    assert (made["preset"], made["quality"], literal["preset"]) == ("snerg", "draft", "paper")
    left = np.count_nonzero(dense_from_pack(ours)[0][..., 3])
    assert made["voxels"]["after"] == left < made["voxels"]["before"] and made["voxels"]["tau_weight"] > 0
    assert made["macroblocks"]["kept"] == np.count_nonzero(ours.occupied)
    assert "voxels" not in literal and "fine_tuning" not in made
    assert passes_of(BakeConfig(preset="paper", quality="draft"))[-1][0] == "padding"


# Views midway between photographs


def test_photographs_come_first_and_each_has_a_wider_view_midway_to_another(dataset: RayDataset) -> None:
    views, pixels = with_views_between(dataset), 48 * 48
    assert dataset.views < views.views <= 2 * dataset.views and views.count == views.views * pixels
    ids = jnp.arange(0, dataset.count, 97)
    for ours, theirs in zip(views.geometry_at(ids), dataset.geometry_at(ids), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    poses = np.asarray(views.world_T_camera, np.float64)
    given = poses[: dataset.views]
    for pose in poses[dataset.views :]:
        middle = 0.5 * (given[:, None, :, 3] + given[None, :, :, 3])
        i, j = np.unravel_index(np.linalg.norm(middle - pose[:, 3], axis=-1).argmin(), (len(given), len(given)))
        np.testing.assert_allclose(pose[:, 3], middle[i, j], atol=1e-6)
        one, here, other = (Rotation.from_matrix(turn[:, :3]) for turn in (given[i], pose, given[j]))
        apart = [(here.inv() * one).magnitude(), (here.inv() * other).magnitude()]
        assert apart == pytest.approx(2 * [0.5 * (one.inv() * other).magnitude()], abs=1e-4), "turned half of the way"
    corners = pixels * np.array([[0], [views.views - 1]]) + [0, 47, pixels - 48, pixels - 1]
    photograph, between = (np.asarray(views.geometry_at(jnp.asarray(ids)).directions) for ids in corners)
    assert (between @ between.T).min() < (photograph @ photograph.T).min() - 0.1
