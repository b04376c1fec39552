"""The order in which a bake tunes voxels and prunes them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from baker.baking import bake as baking
from baker.baking import to_pack, tuned_voxels
from baker.baking.config import BakeConfig
from baker.baking.stages import Stages
from baker.tuning.joint_loop import JointConfig
from baker.tuning.pruning import FIRM, Pruned
from scenepack.blocks import dense_from_pack
from scenepack.codecs.quantisation import EXACT
from tests.scenepack.random_packs import random_pack
from training.dataset import RayDataset
from training.run import load_run
from training.scenes import Scene

Call = tuple[str, Any]
OLDER = Path(__file__).parents[2] / "data/older"


class HandedOver(Exception):
    """What a bake has come to."""


def test_what_tunes_compares_with_photographs_in_the_look_of_the_field(
    scene: Scene, dataset: RayDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    gains = np.ones((dataset.views, 3), np.float32)
    gains[:, 0] = np.linspace(0.5, 1.5, dataset.views)
    pack, seen = random_pack(np.random.default_rng(0)), []

    def voxels(pack: Any, photographs: RayDataset, *_: Any) -> Any:
        seen.append(photographs)
        raise HandedOver

    def view_mlp(pack: Any, photographs: RayDataset, **_: Any) -> Any:
        seen.append(photographs)
        return pack, 0.0, 0.0

    culling = SimpleNamespace(kept=None, counts=dict)
    method = SimpleNamespace(view_mlp=lambda state: None, gains=lambda state: gains)
    run: Any = SimpleNamespace(method=method, dataset=dataset, scene=scene, state=0)
    grid = SimpleNamespace(voxel_size=1, min_xyz=0, size=(1, 1, 1), worldspace_T_opengl=np.eye(4), contraction=None)
    monkeypatch.setattr(baking, "check_bake", lambda *_: None)
    monkeypatch.setattr(baking, "_culled", lambda *_: (grid, culling))
    monkeypatch.setattr(baking, "_content", lambda *_: ())
    monkeypatch.setattr(baking, "fill_atlas", lambda *_: (0, 0, 0))
    monkeypatch.setattr(baking, "restore_padding", lambda *_: None)
    monkeypatch.setattr(baking, "Pack", lambda **_: pack)
    monkeypatch.setattr(baking, "fine_tune", view_mlp)
    monkeypatch.setattr(baking, "with_tuned_voxels", voxels)
    with pytest.raises(HandedOver):
        baking.bake(run, BakeConfig(tau_weight=0.0))
    assert len(seen) == 2
    ids = np.arange(0, dataset.count, 7, dtype=np.int32)
    shown = np.asarray(dataset.in_average_look(gains).colours_at(ids))
    assert np.abs(shown - np.asarray(dataset.colours_at(ids))).max() > 0.1
    assert all(np.array_equal(np.asarray(photographs.colours_at(ids)), shown) for photographs in seen)


@pytest.fixture
def lost() -> float:
    """dB that rounding to coarse steps costs before tuning."""
    return 0.07


@pytest.fixture
def helps_gently() -> float:
    """dB that tuning helps by at low rates."""
    return 0.0


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch, helps: float, helps_gently: float, lost: float) -> list[Call]:
    """What the stages were called with, in order, while tuning helps by so many dB, and rounding costs so many."""
    noted: list[Call] = []

    def joint_tune(pack: Any, dataset: Any, config: Any, on_share: Any, by_opacity: bool) -> Any:
        noted.append(("tune", config))
        samples = 10.0 - len(noted)
        gained = helps_gently if config.rate == tuned_voxels.GENTLE * JointConfig().rate else helps
        return pack, {
            "passes": config.passes, "held_out_psnr_before": 30.0, "held_out_psnr_after": 30.0 + gained,
            "samples_a_ray_before": 12.0, "samples_a_ray_after": samples,
        }  # fmt: skip

    def prune(pack: Any, dataset: Any, tau: float, *rest: Any) -> Any:
        closing, score, most_lost = rest[-3:]
        noted.append(("prune", (most_lost, tau, closing)))
        assert score(pack) == 29.0
        return replace(pack, params={"thinner": True}), Pruned(100, 80, 3, tau)

    def follow(pack: Any, light: Any, steps: Any, score: Any, most_lost: float) -> Any:
        noted.append(("follow", steps))
        assert light == "light" and score(pack) == 29.0 and most_lost == tuned_voxels.MOST_LOST_HIDDEN
        return pack, 64

    monkeypatch.setattr(tuned_voxels, "joint_tune", joint_tune)
    monkeypatch.setattr(tuned_voxels, "smooth_hidden", follow)
    monkeypatch.setattr(tuned_voxels, "light_of", lambda *_: "light")
    monkeypatch.setattr(tuned_voxels, "prune", prune)
    monkeypatch.setattr(tuned_voxels, "lost_to_steps", lambda pack, dataset, steps, seed, by_opacity: lost)
    monkeypatch.setattr(tuned_voxels, "with_views_between", lambda dataset: dataset)
    monkeypatch.setattr(tuned_voxels, "shown_psnr", lambda *args, **options: 29.0)
    return noted


def tuned(config: BakeConfig) -> Any:
    """What a bake makes of a pack that is ready to be tuned: pack, figures, what was pruned."""
    return tuned_voxels.with_tuned_voxels(random_pack(np.random.default_rng(0)), None, config, Stages(), False)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("helps", "expected"), [(0.5, ["tune", "prune", "tune", "follow"]), (0.0, ["tune", "tune", "tune", "follow"])]
)
def test_what_is_compact_ends_in_coarser_steps_whether_tuning_helps_or_not(
    calls: list[Call], helps: float, expected: list[str]
) -> None:
    config = BakeConfig(fine_tune="compact")
    figures = tuned(config)[1]
    assert [name for name, _ in calls] == expected and figures["of"] == "compact" and figures["hidden_below"] == 64
    first, last = calls[0][1], calls[-2][1]
    assert first.steps == EXACT and last.steps == calls[-1][1] == tuned_voxels.COMPACT != EXACT
    assert last.held_out == (0 if helps else first.held_out), "what does not help is kept only where it is best"


@pytest.mark.parametrize(
    ("helps", "lost", "came_to", "expected"),
    [
        (0.5, 0.07, "compact", ["tune", "prune", "tune", "follow"]),
        (0.5, 0.8, "all", ["tune", "prune", "tune"]),  # mist: faint voxels are most of what is seen
        (0.0, 0.07, "all", ["tune", "tune"]),
    ],
)
def test_by_default_what_is_stored_is_rounded_where_tuning_makes_up_for_it(
    calls: list[Call], came_to: str, expected: list[str]
) -> None:
    figures = tuned(BakeConfig())[1]
    assert figures["of"] == came_to and [name for name, _ in calls] == expected
    if len(expected) > 2:
        assert calls[2][1].steps == (tuned_voxels.COMPACT if came_to == "compact" else EXACT)


@pytest.mark.parametrize(("helps", "lost"), [(0.5, 0.8)])
def test_who_asks_for_a_compact_pack_gets_one_whatever_it_costs(calls: list[Call]) -> None:
    figures = tuned(BakeConfig(fine_tune="compact"))[1]
    assert figures["of"] == "compact" and "lost_to_steps" not in figures and calls[-1][0] == "follow"


@pytest.mark.parametrize(("codec", "expected"), [("png", "auto"), ("webp", "auto"), ("jpeg", "all"), ("avif", "all")])
def test_nothing_is_rounded_for_a_codec_that_rounds_by_itself(
    codec: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[BakeConfig] = []

    def check(run: Any, config: BakeConfig) -> None:
        asked.append(config)
        raise HandedOver

    monkeypatch.setattr(to_pack, "check_bake", check)
    for chosen in ("auto", "compact"):
        with pytest.raises(HandedOver):
            to_pack.bake_to(None, BakeConfig(fine_tune=chosen), tmp_path / "pack", codec)  # type: ignore[arg-type]
    assert [config.fine_tune for config in asked] == [expected, "compact"]


@pytest.mark.parametrize(
    ("helps", "tau", "expected"),
    [
        (0.5, 0.01, ["tune", "prune", "tune"]),
        (0.5, 0.0, ["tune", "tune"]),
        (0.0, 0.01, ["tune", "tune"]),
    ],
)
def test_where_tuning_helps_faint_voxels_go_and_all_views_are_tuned_on(
    calls: list[Call], helps: float, tau: float, expected: list[str]
) -> None:
    pack, figures, removed = tuned(BakeConfig(tau_weight=tau, seed=7, fine_tune="all"))
    assert [name for name, _ in calls] == expected
    first = calls[0][1]
    assert first.held_out > 0 and first.seed == 7, "views are held out until they have told that tuning helps"
    assert figures["held_out_psnr_after"] == 30.0 + helps
    if helps:
        last = calls[-1][1]
        assert last.held_out == 0 and last.seed != first.seed
        assert figures["passes"] == first.passes + last.passes and figures["samples_a_ray_after"] == 10.0 - len(calls)
    if "prune" in expected:
        assert calls[1][1] == (tuned_voxels.MOST_LOST_AGAIN, pytest.approx(0.04), FIRM)
        assert removed == Pruned(100, 80, 3, pytest.approx(0.04)) and pack.params == {"thinner": True}
    else:
        assert removed is None and pack.params == {}


@pytest.mark.parametrize("helps", [0.0, -0.2])
@pytest.mark.parametrize("helps_gently", [0.02, 0.0])
def test_photographs_that_disagree_are_tuned_gently_and_keep_all_of_their_voxels(
    calls: list[Call], helps_gently: float
) -> None:
    pack, figures, removed = tuned(BakeConfig(seed=7))
    (_, first), (_, gentle) = calls
    assert gentle == replace(first.slower(tuned_voxels.GENTLE), least_gain=0.0) and gentle.held_out > 0
    assert first.least_gain == tuned_voxels.LEAST_GAIN, "what hardly helps is better done gently"
    assert (gentle.rate, gentle.head_rate) == (
        pytest.approx(tuned_voxels.GENTLE * first.rate), pytest.approx(tuned_voxels.GENTLE * first.head_rate),
    )  # fmt: skip
    assert figures["of"] == "all" and figures["gently"] is (helps_gently > 0) and figures["passes"] == 2.0
    assert figures["held_out_psnr_after"] == 30.0 + helps_gently
    assert removed is None and pack.params == {}


@pytest.mark.parametrize(("compact", "steps"), [(True, tuned_voxels.COMPACT), (False, EXACT)])
@pytest.mark.parametrize(("helps", "tau", "expected"), [(0.5, 0.01, 0.01), (0.5, 0.0, tuned_voxels.TAU_WEIGHT)])
def test_what_gets_thinner_may_lose_what_was_asked_and_stays_in_its_steps(
    calls: list[Call], monkeypatch: pytest.MonkeyPatch, compact: bool, steps: Any, tau: float, expected: float
) -> None:
    asked: list[Any] = []

    def thin(pack: Any, light: Any, tau_weight: float, steps: Any, score: Any, most_lost: float) -> Any:
        asked.append((light, tau_weight, steps, score(pack), most_lost))
        return pack, Pruned(100, 80, 3, tau_weight)

    monkeypatch.setattr(tuned_voxels, "thin", thin)
    bar: Any = SimpleNamespace(update=None)
    pack = random_pack(np.random.default_rng(0))
    made, figures = tuned_voxels.thinned(pack, None, BakeConfig(tau_weight=tau, thin=0.25), False, compact, bar)  # type: ignore[arg-type]
    assert made is pack and figures is not None and figures.macroblocks == 3
    assert asked == [("light", expected, steps, 29.0, 0.25)]


@pytest.mark.parametrize("helps", [0.5])
def test_what_shall_be_thin_is_thinned_in_exact_steps_before_it_is_tuned_for_the_last_time(
    calls: list[Call], monkeypatch: pytest.MonkeyPatch
) -> None:
    def thin(pack: Any, light: Any, tau_weight: float, steps: Any, score: Any, most_lost: float) -> Any:
        calls.append(("thin", (steps, most_lost)))
        return replace(pack, params={"thinner": True}), Pruned(100, 60, 5, tau_weight)

    monkeypatch.setattr(tuned_voxels, "thin", thin)
    pack, _, removed = tuned(BakeConfig(fine_tune="all", thin=0.25))
    assert [name for name, _ in calls] == ["tune", "thin", "tune"]
    assert calls[1][1] == (EXACT, pytest.approx(tuned_voxels.MOST_LOST_AGAIN + 0.25))
    assert pack.params == {"thinner": True} and removed is not None and removed.voxels_after == 60


def test_a_bake_that_gives_up_quality_stores_less_and_says_so() -> None:
    loaded = load_run(OLDER / "multires", scene_path=OLDER / "scene")
    full, thinner = (baking.bake(loaded, BakeConfig(resolution=31, fine_tune="none", thin=thin)) for thin in (0.0, 3.0))
    made = thinner.metadata["provenance"]
    told = made["thin"]
    assert "thin" not in full.metadata["provenance"] and told["most_lost"] == 3.0
    voxels = [np.count_nonzero(dense_from_pack(pack)[0][..., 3]) for pack in (full, thinner)]
    assert voxels == [told["before"], told["after"]] and voxels[1] < voxels[0]
    assert made["voxels"]["after"] == voxels[1] and made["voxels"]["before"] >= voxels[0]
    assert made["macroblocks"]["kept"] == np.count_nonzero(thinner.occupied)
