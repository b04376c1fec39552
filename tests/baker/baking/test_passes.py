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
    ids = np.arange(0, dataset.count, 7, dtype=np.int32)
    shown = np.asarray(dataset.in_average_look(gains).colours_at(ids))
    assert np.abs(shown - np.asarray(dataset.colours_at(ids))).max() > 0.1
    assert len(seen) == 1 and np.array_equal(np.asarray(seen[0].colours_at(ids)), shown)


def test_scaled_features_say_the_same_to_the_view_mlp(dataset: RayDataset) -> None:
    pack = random_pack(np.random.default_rng(0))
    assert pack.atlas_features is not None and pack.view_mlp is not None
    before, weights = pack.atlas_features.astype(float), pack.view_mlp.weights[0][-4:]
    with progress("", 1.0, quiet=True) as bar:
        scaled = passes.with_scaled_features(passes.Voxels(pack, dataset, BakeConfig()), bar).pack
    assert scaled.atlas_features is not None and scaled.view_mlp is not None
    now = scaled.view_mlp.weights[0]
    assert scaled.atlas_features.max() <= 64 and np.array_equal(now[:-4], pack.view_mlp.weights[0][:-4])
    rounding = 0.5 * np.abs(now[-4:]).sum(axis=0) + 1e-3
    assert np.all(np.abs(scaled.atlas_features @ now[-4:] - before @ weights) <= rounding)


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


def test_photographs_come_first_and_each_has_a_view_between(dataset: RayDataset) -> None:
    views = with_views_between(dataset)
    assert dataset.views < views.views <= 2 * dataset.views and views.count == views.views * 48 * 48
    ids = jnp.arange(0, dataset.count, 97)
    for ours, theirs in zip(views.geometry_at(ids), dataset.geometry_at(ids), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    poses = np.asarray(views.world_T_camera, np.float64)
    turns, given = poses[dataset.views :, :, :3], poses[: dataset.views]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-6)
    for pose in poses[dataset.views :]:
        middle = 0.5 * (given[:, None, :, 3] + given[None, :, :, 3])
        i, j = np.unravel_index(np.linalg.norm(middle - pose[:, 3], axis=-1).argmin(), (len(given), len(given)))
        np.testing.assert_allclose(pose[:, 3], middle[i, j], atol=1e-6)
        both = [Rotation.from_matrix(given[k, :, :3]) for k in (i, j)]
        here = Rotation.from_matrix(pose[:, :3])
        apart = [(here.inv() * other).magnitude() for other in both]
        assert apart[0] == pytest.approx(apart[1], abs=1e-4), "turned as much from the one as from the other"
        assert sum(apart) == pytest.approx((both[0].inv() * both[1]).magnitude(), abs=1e-4)


def test_a_view_between_shows_more_on_every_side_than_a_photograph(dataset: RayDataset) -> None:
    views, pixels = with_views_between(dataset), 48 * 48

    def widest(view: int) -> float:
        """The largest angle between rays of a view, as a cosine."""
        at = np.asarray(views.geometry_at(view * pixels + jnp.array([0, 47, pixels - 48, pixels - 1])).directions)
        return float((at @ at.T).min())

    assert widest(views.views - 1) < widest(0) - 0.1
