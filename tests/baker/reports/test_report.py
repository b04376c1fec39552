"""python -m baker.commands.report: its figures are those of the commands it stands for, its pictures those of the packs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from baker.commands.evaluate import main as snerg_eval
from baker.commands.report import main
from baker.reports.cross_sections import OPAQUE, draw_sections, placed, section, shares
from baker.reports.pack_compare import stored_bytes
from scenepack import load_pack
from scenepack.blocks import dense_from_pack
from tests.scenepack.random_packs import random_pack
from tests.told import told
from training.commands.train import main as snerg_train

pytestmark = pytest.mark.slow

SMALL = ["--resolution", "30", "--resolutions", "30,40", "--fine-tune", "none,view-mlp", "--fine-tune-epochs", "3"]
SMALL += ["--frames", "2", "--size", "32x32", "--quick"]


@pytest.fixture(scope="module")
def runs(scene_path: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A run, and in place of one without the sparsity loss the same run a hundred steps earlier: another field."""
    folder = tmp_path_factory.mktemp("runs")
    sparse, foggy = folder / "sparse", folder / "foggy"
    assert snerg_train([str(scene_path), "--preset", "tiny", "--out", str(sparse)]) == 0
    shutil.copytree(sparse, foggy)
    sorted((foggy / "checkpoints").iterdir())[-1].unlink()
    description = json.loads((foggy / "config.json").read_text())
    description["config"]["sparsity_weight"] = 0.0
    (foggy / "config.json").write_text(json.dumps(description))
    return sparse, foggy


@pytest.fixture(scope="module")
def out(runs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "out"
    words = ["--against", str(runs[1]), *SMALL]
    assert main([str(runs[0]), "--out", str(out), *words]) == 0
    return out


@pytest.fixture(scope="module")
def tables(out: Path) -> dict:
    return json.loads((out / "report.json").read_text())["tables"]


def test_the_ladder_scores_as_snerg_eval_does(
    out: Path, tables: dict, runs: tuple[Path, Path], scene_path: Path, tmp_path: Path
) -> None:
    rows = {row["of"]: row for row in tables["ladder"]["rows"]}
    assert list(rows) == ["field", "none", "view-mlp"]
    for of, subject in (("field", runs[0]), ("view-mlp", out / "packs" / "30-view-mlp")):
        assert snerg_eval([str(subject), "--scene", str(scene_path), "--json", str(tmp_path / "e.json")]) == 0
        told = json.loads((tmp_path / "e.json").read_text())
        assert rows[of]["psnr"] == pytest.approx(told["psnr"], abs=1e-6)
        assert rows[of]["ssim"] == pytest.approx(told["ssim"], abs=1e-6)
    assert rows["none"]["psnr"] != rows["view-mlp"]["psnr"], "fine-tuning changes the pack"
    assert rows["none"]["bytes"] == stored_bytes(out / "packs" / "30-none")
    text = (out / "report.md").read_text()
    assert f"| {rows['none']['psnr']:.2f} |" in text and f"{rows['field']['psnr']:.2f}" in text


def test_resolutions_codecs_and_times_are_of_the_packs(out: Path, tables: dict) -> None:
    coarse, fine = tables["resolution"]["rows"]
    pack = load_pack(out / "packs" / "40-view-mlp")
    assert (coarse["resolution"], fine["resolution"]) == (30, 40)
    assert fine["grid"] == list(pack.grid_size) and fine["macroblocks"] == pack.occupied.sum()
    assert fine["bytes"] == stored_bytes(out / "packs" / "40-view-mlp")
    assert fine["ms_p50"] > 0 and fine["gpu_bytes"] > 0 and tables["resolution"]["renderer"]
    codecs = {row["codec"]: row for row in tables["codecs"]["rows"]}
    assert codecs["png"]["psnr"] == pytest.approx(coarse["psnr"], abs=1e-6) == pytest.approx(codecs["webp"]["psnr"])


def test_the_sparsity_table_counts_what_is_in_both_packs(out: Path, tables: dict) -> None:
    rows = tables["sparsity"]["rows"]
    assert rows[0]["sparsity_weight"] > rows[1]["sparsity_weight"] == 0
    for row, name in zip(rows, ("30-view-mlp-all-voxels", "against-30-view-mlp-all-voxels"), strict=True):
        pack = load_pack(out / "packs" / name)
        alpha = dense_from_pack(pack)[0][..., 3]
        assert row["macroblocks"]["occupied"] == pack.occupied.sum()
        assert row["voxels"]["with_alpha"] == (alpha > 0).sum() == sum(row["alpha_histogram"])
        if name.startswith("30"):
            cut = next(cut for cut in tables["sparsity"]["sections"] if cut["axis"] == "z")
            middle = alpha[pack.grid_size[2] // 2]
            assert cut["shares"][row["label"]]["opaque"] == pytest.approx((middle >= OPAQUE).mean())
            assert cut["shares"][row["label"]]["with_alpha"] == pytest.approx((middle > 0).mean())


def test_every_picture_that_the_report_shows_is_there(out: Path) -> None:
    text = (out / "report.md").read_text()
    shown = [part.split(")")[0] for part in text.split("](")[1:]]
    assert {"resolution.png", "codecs.png", "sparsity.png", "cross-section-x.png"} <= set(shown)
    for name in shown:
        with Image.open(out / name) as picture:
            assert np.asarray(picture.convert("L")).std() > 1, name


def test_the_same_line_again_bakes_nothing_and_keeps_the_other_tables(
    out: Path, runs: tuple[Path, Path], capsys: pytest.CaptureFixture
) -> None:
    before = {path: path.stat().st_mtime_ns for path in (out / "packs").iterdir()}
    figures = json.loads((out / "report.json").read_text())
    words = ["--tables", "ladder", *SMALL]
    assert main([str(runs[0]), "--out", str(out), *words]) == 0
    assert "macroblocks" not in capsys.readouterr().out, "a bake tells what it made"
    assert before == {path: path.stat().st_mtime_ns for path in (out / "packs").iterdir()}
    assert json.loads((out / "report.json").read_text()) == figures


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_section_is_the_packs_own_voxels_upright(axis: int, tmp_path: Path) -> None:
    pack = random_pack(np.random.default_rng(4), block_size=6, grid_blocks=(2, 3, 4), style="blob", alpha_style="any")
    others = tuple(i for i in range(3) if i != 2 - axis)
    index = int(dense_from_pack(pack)[0][..., 3].astype(int).sum(others).argmax())  # the fullest plane
    cut = section(pack, axis, float(pack.min_xyz[axis] + (index + 0.5) * pack.voxel_size))
    plane = np.take(dense_from_pack(pack)[0], index, axis=2 - axis)  # [z, y], [z, x] or [y, x]
    expected = {0: plane.transpose(1, 0, 2)[::-1], 1: plane, 2: plane[::-1]}[axis]
    assert expected[..., 3].any()
    np.testing.assert_array_equal(cut.rgba, expected)
    assert not cut.rgba[~cut.stored].any(), "only stored macroblocks hold anything"
    missed = section(pack, axis, float(pack.max_xyz[axis] + 1))
    assert shares(missed) == {"opaque": 0, "with_alpha": 0, "stored": 0}
    rgba, stored = placed(cut, cut.low, cut.high, cut.step)
    np.testing.assert_array_equal(rgba, cut.rgba)
    np.testing.assert_array_equal(stored, cut.stored)
    wider, _ = placed(cut, cut.low - cut.step, cut.high + 2 * cut.step, cut.step)
    np.testing.assert_array_equal(wider[2:-1, 1:-2] if cut.upward else wider[1:-2, 1:-2], cut.rgba)
    draw_sections(tmp_path / "cut.png", {"hit": cut, "missed": missed})
    with Image.open(tmp_path / "cut.png") as opened:
        assert opened.width > 200


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--tables", "ladder,prices"], "--tables"),
        (["--resolutions", "big"], "--resolutions"),
        (["--resolution", "12"], "--resolution"),
        (["--split", "holiday"], "--split"),
        (["--fine-tune", "most"], "--fine-tune"),
        (["--against", "nowhere"], "nowhere"),
    ],
)
def test_what_cannot_be_done_is_told_in_one_line_before_anything_is_baked(
    runs: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture, words: list[str], expected: str
) -> None:
    capsys.readouterr()
    assert main([str(runs[0]), "--out", str(tmp_path / "out"), *words]) == 2
    [error] = told(capsys.readouterr().err)
    assert expected in error
    assert not (tmp_path / "out").exists()
