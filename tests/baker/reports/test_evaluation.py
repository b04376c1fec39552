"""snerg-eval: masked by the subject's own opacity as the paper does, and reading a scene as its run or pack did."""

from __future__ import annotations

import dataclasses
import json
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from baker.reports import evaluation
from baker.reports.evaluation import evaluate, reading_of
from scenepack import save_pack
from tests.scenepack.helpers import small_pack
from training.scenes import Scene, picture_stems


def test_masked_by_alpha_what_lies_outside_of_the_subject_does_not_count(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    held_out = {id(p.camera): p.load() for p in scene.splits["test"]}

    @contextmanager
    def shown_by(subject: Path):
        def show(camera, mode):
            rgba = held_out[id(camera)]
            opaque = np.zeros(rgba.shape[:2], np.float32)
            opaque[12:36, 12:36] = 1  # the subject ends here, well inside of what was photographed
            if mode == "alpha":
                return opaque
            shown = evaluation.over_background(rgba, scene.background)
            return np.where(opaque[..., None] > 0, shown, 1.0).astype(np.float32)

        yield show

    monkeypatch.setattr(evaluation, "shown_by", shown_by)
    assert evaluate(Path("pack"), scene, "test", by_alpha=True)["psnr"] > 100
    assert evaluate(Path("pack"), scene, "test")["psnr"] < 40


def test_a_scene_is_read_as_the_run_or_the_pack_read_it(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    options = {"downscale": 4, "spherify": True, "masks": True}
    (run / "config.json").write_text(json.dumps({"format": 1, "scene": "s", "scene_options": options, "config": {}}))
    assert reading_of(run) == {"spherify": True, "masks": True}

    pack = small_pack()
    save_pack(pack, tmp_path / "published")
    assert reading_of(tmp_path / "published") == {"spherify": None, "masks": False}
    save_pack(pack.with_metadata(provenance=options), tmp_path / "ours")
    assert reading_of(tmp_path / "ours") == {"spherify": True, "masks": True}


@pytest.mark.parametrize(
    ("names", "stems"),
    [
        (["train/r_0.png", "train/r_1.png"], ["r_0", "r_1"]),
        (["a/000.png", "b/000.png", "b/001.png"], ["a-000", "b-000", "b-001"]),
        (["a.png", "a.jpg", "./A.png"], ["a", "a-1", "A-2"]),
        (["../x/1.png", "x/1.png"], ["x-1", "x-1-1"]),
    ],
)
def test_no_two_photographs_share_the_name_of_a_picture(names: list[str], stems: list[str], scene: Scene) -> None:
    one = scene.splits["test"][0]
    assert picture_stems([dataclasses.replace(one, name=name) for name in names]) == stems


def test_pictures_of_photographs_of_one_name_are_all_kept(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def shown_by(subject: Path):
        yield lambda camera, mode: np.ones((camera.height, camera.width, 3), np.float32)

    monkeypatch.setattr(evaluation, "shown_by", shown_by)
    pair = [dataclasses.replace(p, name=f"{n}/000.png") for n, p in zip("ab", scene.splits["test"], strict=False)]
    evaluate(Path("pack"), dataclasses.replace(scene, splits={"test": tuple(pair)}), "test", tmp_path / "images")
    assert sorted(path.name for path in (tmp_path / "images").iterdir()) == ["a-000.png", "b-000.png"]
