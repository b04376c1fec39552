"""snerg-pack compare, and the table of codecs: what is drawn, what is told, in which room."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from baker.commands.pack import main
from baker.reports.codec_report import as_markdown, measured
from scenepack import Pack, save_pack
from tests.scenepack.random_packs import random_pack
from training.scenes import Scene


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
