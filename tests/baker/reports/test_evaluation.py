"""snerg-eval: masked by the subject's own opacity as the paper does, and reading a scene as its run or pack did."""

import json
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baker.commands.pack import main
from baker.reports import evaluation
from baker.reports.evaluation import evaluate, reading_of
from scenepack import save_pack
from tests.scenepack.helpers import small_pack
from tests.scenepack.random_packs import random_pack
from training.scenes import Scene

Spoil = Callable[[np.ndarray], np.ndarray]


def showing(scene: Scene, width: Callable[[str], int], spoil: Spoil = lambda right: right) -> Callable[..., Any]:
    """Stands in for evaluation.shown_by: each held-out photograph, spoilt, in the rectangle that its subject fills.

    width: of the rectangle, in pixels, by the subject's name; outside of it, all is white.
    """
    held_out = {id(p.camera): p.load() for p in scene.splits["test"]}

    @contextmanager
    def shown_by(subject: Path, allow_half: bool, photographs: Path):
        def show(camera, mode):
            rgba = held_out[id(camera)]
            opaque = np.zeros(rgba.shape[:2], np.float32)
            opaque[12:36, 12 : 12 + width(subject.name)] = 1  # well inside of what was photographed
            if mode == "alpha":
                return opaque
            shown = spoil(evaluation.over_background(rgba, scene.background))
            return np.where(opaque[..., None] > 0, shown, 1.0).astype(np.float32)

        yield evaluation.Drawn(show)

    return shown_by


def test_masked_by_alpha_what_lies_outside_of_the_subject_does_not_count(scene, monkeypatch):
    monkeypatch.setattr(evaluation, "shown_by", showing(scene, lambda name: 24))
    scores = evaluate(Path("pack"), scene, "test", by_alpha=True)
    assert scores["psnr"] > 100
    assert scores["psnr_matched"] == pytest.approx(scores["psnr"], abs=1), "nothing is to be matched"
    assert evaluate(Path("pack"), scene, "test")["psnr"] < 40


def test_a_picture_of_another_exposure_has_a_second_figure_and_the_first_is_not_flattered(scene, monkeypatch):
    def dimmed(right: np.ndarray) -> np.ndarray:
        subject = (right < 1).any(-1, keepdims=True)  # the background is nobody's photograph
        return np.where(subject, right * np.array([0.8, 0.7, 0.75], np.float32) + np.float32(0.02), right)

    monkeypatch.setattr(evaluation, "shown_by", showing(scene, lambda name: 48, dimmed))
    scores = evaluate(Path("pack"), scene, "test", by_alpha=True)
    assert scores["psnr"] < 30 and scores["psnr_matched"] > scores["psnr"] + 3
    assert scores["psnr_matched"] == pytest.approx(np.mean([view["psnr_matched"] for view in scores["views"]]))


def test_a_scene_is_read_as_the_run_or_the_pack_read_it(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    options = {"downscale": 4, "spherify": True, "masks": True, "up": [0, 1, 2]}
    expected = {"spherify": True, "masks": True, "up": (0.0, 1.0, 2.0)}
    (run / "config.json").write_text(json.dumps({"format": 1, "scene": "s", "scene_options": options, "config": {}}))
    assert reading_of(run) == expected
    pack = small_pack()
    save_pack(pack, tmp_path / "published")
    assert reading_of(tmp_path / "published") == {"spherify": None, "masks": False, "up": None}
    save_pack(pack.with_metadata(provenance=options), tmp_path / "ours")
    assert reading_of(tmp_path / "ours") == expected


def test_two_methods_are_scored_on_the_same_pixels_with_the_mask_of_one(scene, monkeypatch):
    def wrong_in_the_right_half(right: np.ndarray) -> np.ndarray:
        return np.where((np.arange(48) >= 24)[None, :, None], 0.0, right)

    shown_by = showing(scene, lambda name: 12 if name == "narrow" else 24, wrong_in_the_right_half)
    monkeypatch.setattr(evaluation, "shown_by", shown_by)
    narrow, wide = Path("narrow"), Path("wide")
    assert evaluate(wide, scene, "test", by_alpha=True)["psnr"] < 40
    by_other = evaluate(wide, scene, "test", mask_of=narrow)
    assert by_other["psnr"] > 100 and by_other["mask"] == "narrow", "its errors lie outside of the other's mask"
    assert evaluate(narrow, scene, "test", mask_of=wide)["psnr"] < 40, "what it lacks of the mask counts"


def test_the_json_of_snerg_pack_compare_has_each_view_and_their_means(tmp_path: Path, capsys) -> None:
    pack = random_pack(np.random.default_rng(2), grid_blocks=(2, 2, 2), style="blob", alpha_style="solid")
    save_pack(pack, tmp_path / "a")
    save_pack(pack, tmp_path / "b", codec="jpeg", quality=20)
    words = ["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--views", "3", "--size", "40x30"]
    assert main([*words, "--json", str(tmp_path / "deep" / "c.json")]) == 0
    capsys.readouterr()
    result = json.loads((tmp_path / "deep" / "c.json").read_text())
    assert (result["width"], result["height"], len(result["views"])) == (40, 30, 3)
    for key in ("psnr", "ssim"):
        assert result[key] == pytest.approx(np.mean([view[key] for view in result["views"]]))
    assert 10 < result["psnr"] < 60 and 0 < result["ssim"] < 1 and result["worst"] > 0
    assert result["b"]["codec"] == "jpeg"
    assert result["b"]["bytes"] == sum(f.stat().st_size for f in (tmp_path / "b").iterdir())
    assert main([*words, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == result
    save_pack(pack, tmp_path / "c.zip", codec="webp")
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "c.zip"), "--views", "2", "--size", "40x30"]) == 0
    assert capsys.readouterr().out.count(": identical\n") == 3, "with its lossless copy"
