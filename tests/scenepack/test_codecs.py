"""Every codec: lossless ones exactly, lossy ones closely, and what is empty stays empty in all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from console import UserError
from scenepack import Pack, load_pack, save_pack
from scenepack.codecs import CODECS
from tests.scenepack.random_packs import random_pack

LOSSLESS = {"png", "webp"}


@pytest.fixture(scope="module")
def pack() -> Pack:
    return random_pack(np.random.default_rng(5), block_size=30, grid_blocks=(2, 2, 2), style="blob")


@pytest.fixture(params=sorted(CODECS))
def codec(request: pytest.FixtureRequest) -> str:
    if request.param == "h264":
        pytest.importorskip("av")
    return request.param


def test_voxels_survive_and_empty_ones_stay_exactly_empty(codec: str, pack: Pack, tmp_path: Path) -> None:
    save_pack(pack, tmp_path / "pack", codec=codec)
    back = load_pack(tmp_path / "pack")
    assert pack.atlas_features is not None and back.atlas_features is not None
    assert np.array_equal(back.atlas_indices, pack.atlas_indices)
    empty = pack.atlas_rgba[..., 3] == 0
    assert not back.atlas_rgba[empty].any()
    pairs = ((back.atlas_rgba, pack.atlas_rgba), (back.atlas_features, pack.atlas_features))
    if codec in LOSSLESS:
        assert all(np.array_equal(got, put) for got, put in pairs)
        return
    assert np.all(back.atlas_rgba[..., :3] <= back.atlas_rgba[..., 3:]), "still premultiplied"
    for got, put in pairs:
        error = np.abs(got.astype(int) - put)[~empty]
        assert 0 < np.mean(error) < 24, "close even on noise, the hardest thing to code"


def test_a_truncated_file_is_refused_in_one_line(codec: str, pack: Pack, tmp_path: Path) -> None:
    save_pack(pack, tmp_path / "pack", codec=codec)
    largest = max((p for p in (tmp_path / "pack").iterdir() if p.suffix != ".json"), key=lambda p: p.stat().st_size)
    largest.write_bytes(largest.read_bytes()[: largest.stat().st_size // 2])
    with pytest.raises(UserError, match=str(tmp_path / "pack")):
        load_pack(tmp_path / "pack")


def test_an_unknown_codec_is_refused(pack: Pack, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="codec"):
        save_pack(pack, tmp_path / "pack", codec="gif")
    assert not (tmp_path / "pack").exists()
