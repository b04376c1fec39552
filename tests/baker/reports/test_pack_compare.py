"""snerg-pack compare, and the table of codecs: what is drawn, what is told, in which room."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from baker.commands.pack import main
from baker.reports.codec_report import as_markdown, measured
from baker.reports.pack_compare import difference
from scenepack import Pack, save_pack
from tests.scenepack.random_packs import random_pack
from tests.told import told
from training.scenes import Scene

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def pack() -> Pack:
    return random_pack(
        np.random.default_rng(2), block_size=14, grid_blocks=(2, 2, 2), style="blob", alpha_style="solid"
    )


def test_a_pack_is_identical_with_its_lossless_copy(pack: Pack, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    save_pack(pack, tmp_path / "a")
    save_pack(pack, tmp_path / "b.zip", codec="webp")
    words = ["compare", str(tmp_path / "a"), str(tmp_path / "b.zip"), "--views", "2", "--size", "40x30"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert out.count(": identical\n") == 3 and "webp" in out


def test_the_json_has_each_view_and_their_means(pack: Pack, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
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


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--views", "0"], "--views"),
        (["--size", "big"], "--size"),
        (["--json", "a/scene_params.json/c.json"], "cannot be written"),
    ],
)
def test_what_cannot_be_done_is_told_in_one_line(
    pack: Pack,
    tmp_path: Path,
    capsys: pytest.CaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    expected: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    save_pack(pack, tmp_path / "a")
    assert main(["compare", "a", "a", "--size", "16x16", "--views", "1", *words]) == 2
    [error] = told(capsys.readouterr().err)
    assert expected in error


def test_packs_of_two_kinds_of_scene_are_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for name, ndc in (("a", False), ("b", True)):
        save_pack(random_pack(np.random.default_rng(1), block_size=6, ndc=ndc), tmp_path / name)
    assert main(["compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert "forward-facing" in capsys.readouterr().err


def test_tiny_pictures_have_no_ssim() -> None:
    black, white = np.zeros((8, 8, 3), np.uint8), np.full((8, 8, 3), 255, np.uint8)
    assert difference(black, white) == {"psnr": pytest.approx(0.0), "ssim": None, "worst": 255}


def test_all_of_snerg_pack_works_without_jax() -> None:
    code = "import baker.commands.pack, baker.reports.pack_compare, sys; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=60).returncode == 0


def test_the_table_has_a_row_for_each_codec(pack: Pack, scene: Scene, tmp_path: Path) -> None:
    save_pack(pack, tmp_path / "a")
    rows = list(
        measured(tmp_path / "a", scene, "test", [("png", None), ("jpeg", 90), ("avif", None)], tmp_path / "work")
    )
    assert [row["codec"] for row in rows] == ["png", "jpeg", "avif"]
    assert rows[0]["psnr_against_pack"] == 120 and rows[1]["psnr_against_pack"] < 100
    assert all(row["bytes"] > 0 and row["encode_s"] > 0 and row["decode_s"] > 0 for row in rows)
    table = as_markdown(rows).splitlines()
    assert len(table) == 2 + 3 and len({line.count("|") for line in table}) == 1
    assert "lossless" in table[2] and "identical" in table[2] and "83 (default)" in table[4]
