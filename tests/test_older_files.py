"""Runs and packs that an older version wrote (tests/data/older) open, look as they did, and go on where they were."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from baker.commands.bake import main as snerg_bake
from baker.commands.evaluate import main as snerg_eval
from scenepack import check_pack, load_pack, save_pack
from scenepack.commands import main as snerg_pack
from tests.older import OLDER, SCENE
from training.commands.train import main as snerg_train
from training.run import load_run
from viewer.commands.render import main as snerg_render
from viewer.rendering.offscreen import create_context

EXPECTED: dict[str, Any] = json.loads((OLDER / "expected.json").read_text(encoding="utf-8"))
PACKS, RUNS = ("png", "avif.zip"), ("nerf", "multires")
VIEW = ["--eye", "2.2,1.8,2.6", "--target", "0,-0.1,0", "--fov", "40", "--size", "80x60"]


@pytest.fixture(scope="module")
def rasteriser() -> str:
    context = create_context()
    name = context.info["GL_RENDERER"]
    context.release()
    return name


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as opened:
        return np.asarray(opened.convert("RGB")).astype(int)


def assert_as_drawn_then(picture: Path, name: str, rasteriser: str) -> None:
    """To the byte on the rasteriser that drew it then, within 1/255 on any other."""
    actual, expected = pixels(picture), pixels(OLDER / "pictures" / name)
    assert expected.std() > 20, "there is something to see"
    assert actual.shape == expected.shape
    assert np.abs(actual - expected).max() <= (0 if rasteriser == EXPECTED["rasteriser"] else 1)


@pytest.mark.parametrize("name", PACKS)
def test_an_older_pack_opens_to_the_same_voxels(name: str) -> None:
    pack = load_pack(OLDER / name)
    assert pack.atlas_features is not None and pack.view_mlp is not None
    found = {"rgba": pack.atlas_rgba, "features": pack.atlas_features}
    assert {key: hashlib.sha256(array.tobytes()).hexdigest() for key, array in found.items()} == EXPECTED["sha256"][
        name
    ]
    assert [finding for finding in check_pack(pack) if finding.severity in ("error", "warning")] == []
    assert snerg_pack(["check", str(OLDER / name)]) == 0
    cameras = pack.metadata["cameras"]
    assert [camera["split"] for camera in cameras] == ["train"] * 7 + ["test"] * 2
    assert pack.metadata["provenance"]["steps"] == 1000


@pytest.mark.parametrize(
    "pack, marcher, picture",
    [("png", "exact", "png.png"), ("png", "paper", "paper.png"), ("avif.zip", "exact", "avif.png")],
)
def test_an_older_pack_is_drawn_as_it_was(
    pack: str, marcher: str, picture: str, tmp_path: Path, rasteriser: str
) -> None:
    assert snerg_render([str(OLDER / pack), "--out", str(tmp_path / "p.png"), *VIEW, "--marcher", marcher]) == 0
    assert_as_drawn_then(tmp_path / "p.png", picture, rasteriser)


def test_an_older_pack_is_drawn_as_it_was_after_it_is_saved_again(tmp_path: Path, rasteriser: str) -> None:
    save_pack(load_pack(OLDER / "png"), tmp_path / "again")
    assert snerg_render([str(tmp_path / "again"), "--out", str(tmp_path / "p.png"), *VIEW]) == 0
    assert_as_drawn_then(tmp_path / "p.png", "png.png", rasteriser)
    before, after = (json.loads((f / "scene_params.json").read_text()) for f in (OLDER / "png", tmp_path / "again"))
    assert after == before


@pytest.mark.parametrize("name", RUNS)
def test_the_field_of_an_older_run_is_drawn_as_it_was(name: str, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(OLDER / name, run)
    config = run / "config.json"
    description = json.loads(config.read_text(encoding="utf-8"))
    config.write_text(json.dumps(description | {"scene": str(tmp_path / "gone")}), encoding="utf-8")  # on any machine
    report, pictures = tmp_path / "report.json", tmp_path / "pictures"
    line = [str(run), "--scene", str(SCENE), "--json", str(report), "--images", str(pictures)]
    assert snerg_eval(line) == 0
    psnr = [view["psnr"] for view in json.loads(report.read_text())["views"]]
    np.testing.assert_allclose(psnr, EXPECTED["psnr"][name], atol=0.01)
    side = 28  # the rendering, its photograph and their amplified difference, side by side
    actual, expected = (pixels(path)[:, :side] for path in (pictures / "r_0.png", OLDER / f"pictures/{name}-field.png"))
    assert expected.std() > 5 and np.abs(actual - expected).max() <= 1


@pytest.mark.parametrize("name", RUNS)
def test_an_older_run_goes_on_with_the_steps_it_would_have_taken_then(name: str, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(OLDER / name, run)
    expected = {int(step): loss for step, loss in EXPECTED["losses"][name].items()}
    options = ["--steps", str(max(expected)), "--log-every", "1", "--validate-every", "0"]
    assert snerg_train([str(SCENE), "--out", str(run), "--resume", *options]) == 0
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    losses = {row["step"]: row["loss"] for row in rows if "loss" in row}
    # The same rays, samples and optimiser: a state that lost a moment, or another draw, is off by a per cent and more.
    np.testing.assert_allclose([losses[step] for step in expected], list(expected.values()), rtol=1e-3)
    assert load_run(run, scene_path=SCENE).step == max(expected)
    assert losses[min(expected) - 1] > 0, "the figures of then are still there"


@pytest.mark.parametrize("name", RUNS)
def test_an_older_run_can_be_baked(name: str, tmp_path: Path) -> None:
    pack = tmp_path / "pack"
    line = [str(OLDER / name), "--out", str(pack), "--resolution", "31", "--quality", "draft"]
    assert snerg_bake([*line, "--scene", str(SCENE)]) == 0
    assert snerg_eval([str(pack), "--scene", str(SCENE), "--json", str(tmp_path / "baked.json")]) == 0
    baked = [view["psnr"] for view in json.loads((tmp_path / "baked.json").read_text())["views"]]
    assert abs(np.mean(baked) - np.mean(EXPECTED["psnr"][name])) < 2.0, "31³ voxels"
    assert load_pack(pack).near == 2.0, "where the rays of training began"
