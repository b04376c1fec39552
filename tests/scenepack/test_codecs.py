"""Every codec: lossless ones exactly, lossy ones closely, and what is empty stays exactly empty in all."""

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baker.commands.pack import main
from console import UserError
from scenepack import Pack, load_pack, save_pack
from scenepack.coarse import coarse_pack
from scenepack.codecs import CODECS
from scenepack.piece_files import follows_grid
from tests.scenepack.helpers import edit_json, images, read_json, same_pack, small_pack, smooth_pack, written
from tests.scenepack.volumes import features_of
from tests.viewer.conftest import toy_pack
from viewer.features.photographs.photographs import psnr

LOSSLESS = {"png", "webp"}
# At the default quality, on smooth content: mean alpha error, and PSNR over voxels in use.
MOST_ALPHA_ERROR, LEAST_PSNR = 2.5, 36.0


@pytest.fixture(scope="module")
def pack() -> Pack:
    return smooth_pack()


@pytest.fixture(params=sorted(CODECS))
def codec(request: pytest.FixtureRequest) -> str:
    return request.param


def test_voxels_survive_and_empty_ones_stay_exactly_empty(codec: str, pack: Pack, tmp_path: Path) -> None:
    save_pack(pack, tmp_path / "pack.zip", codec=codec)
    with warnings.catch_warnings(action="error"):
        back = load_pack(tmp_path / "pack.zip")
    if codec in LOSSLESS:
        assert same_pack(back, pack)
        return
    used, features = pack.atlas_rgba[..., 3] > 0, features_of(back)
    assert np.array_equal(back.atlas_rgba[..., 3] > 0, used), "what was empty, and nothing else"
    assert not back.atlas_rgba[~used].any() and not features[~used].any()
    error = np.abs(back.atlas_rgba[..., 3].astype(int) - pack.atlas_rgba[..., 3])[used]
    assert error.mean() <= MOST_ALPHA_ERROR
    for got, put in ((back.atlas_rgba, pack.atlas_rgba), (features, features_of(pack))):
        assert psnr(got[used], put[used]) >= LEAST_PSNR
    assert same_pack(replace(back, atlas_rgba=pack.atlas_rgba, atlas_features=pack.atlas_features), pack)


@pytest.mark.parametrize(
    "options", [{"diffuse": True}, {"block_size": 30, "grid_blocks": (1, 1, 2)}, {"block_size": 3}]
)
def test_packs_of_all_kinds_come_back(codec: str, tmp_path: Path, options: dict[str, Any]) -> None:
    before = small_pack(**options)
    save_pack(before, tmp_path / "pack", codec=codec)
    back = load_pack(tmp_path / "pack")
    assert back.atlas_rgba.shape == before.atlas_rgba.shape
    assert (back.atlas_features is None) == (before.atlas_features is None)
    assert (back.view_mlp is None) == (before.view_mlp is None)
    assert np.array_equal(back.atlas_rgba[..., 3] > 0, before.atlas_rgba[..., 3] > 0)


def test_webp_keeps_packs_voxel_by_voxel_that_break_the_rules(tmp_path: Path) -> None:
    untidy = small_pack()
    atlas = untidy.atlas_rgba.copy()
    atlas[0, 0, 0] = 1, 2, 3, 4  # padding at the grid's edge
    untidy = replace(untidy, atlas_rgba=atlas)
    assert follows_grid(small_pack(), small_pack().atlas_rgba) and not follows_grid(untidy, atlas)
    save_pack(untidy, tmp_path / "pack", codec="webp")
    assert read_json(tmp_path / "pack")["snerg"]["codec_settings"]["layout"] == "atlas"
    assert same_pack(load_pack(tmp_path / "pack"), untidy)


def test_more_quality_is_more_bytes_and_less_error(codec: str, pack: Pack, tmp_path: Path) -> None:
    if codec in LOSSLESS:
        with pytest.raises(UserError, match="has no quality"):
            save_pack(pack, tmp_path / "pack", codec=codec, quality=50)
        return
    figures = []
    for quality in (40, 95):
        save_pack(pack, tmp_path / "pack", codec=codec, quality=quality)
        size = sum(f.stat().st_size for f in images(tmp_path / "pack"))
        figures.append((size, psnr(load_pack(tmp_path / "pack").atlas_rgba, pack.atlas_rgba)))
    assert figures[0][0] < figures[1][0] and figures[0][1] < figures[1][1]
    for quality in (0, 101):
        with pytest.raises(UserError, match="out of range"):
            save_pack(pack, tmp_path / "pack", codec=codec, quality=quality)


def test_features_in_few_levels_are_coded_as_much_finer(codec: str, pack: Pack, tmp_path: Path) -> None:
    features, errors = features_of(pack), []
    assert features.max() > 128
    for scale in (1, 4):  # bakes store a quarter (baker.baking.passes)
        save_pack(replace(pack, atlas_features=features // scale), tmp_path / "pack", codec=codec)
        stored = features_of(load_pack(tmp_path / "pack")).astype(float)
        errors.append(float(np.sqrt(np.mean((scale * stored - scale * (features // scale)) ** 2))))
    assert errors[1] <= 2 * errors[0], "2.2 to 3.8 times as large where steps are as coarse"


def test_a_file_of_any_kind_that_is_cut_off_or_of_another_size_is_refused_in_one_line(codec, tmp_path):
    """Otherwise spoilt ones: tests.fuzz."""
    save_pack(small_pack(), tmp_path / "pack", codec=codec)
    save_pack(small_pack(grid_blocks=(4, 4, 3), occupancy=0.5), tmp_path / "other", codec=codec)
    kinds = {file.name.rsplit("_0", 1)[0]: file for file in images(tmp_path / "pack")}
    for file in kinds.values():
        good, foreign = file.read_bytes(), (tmp_path / "other" / file.name).read_bytes()
        spoilt = {good[: len(good) // 2]: file.name} | ({} if file.suffix == ".xz" else {foreign: "expected"})
        for data, said in spoilt.items():
            file.write_bytes(data)
            with pytest.raises(UserError, match=said) as caught:
                load_pack(tmp_path / "pack")
            assert "\n" not in str(caught.value)
        file.write_bytes(good)
    load_pack(tmp_path / "pack")


def test_without_pyav_h264_is_told_in_one_line_and_all_else_works(pack, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)  # as Python has what cannot be imported
    with pytest.raises(UserError, match=r"snerg\[video\]"):
        save_pack(pack, tmp_path / "pack", codec="h264")
    save_pack(pack, tmp_path / "pack", codec="avif", quality=30)
    edit_json(tmp_path / "pack", lambda p: p.update(format="h264"))
    with pytest.raises(UserError, match=r"snerg\[video\]"):
        load_pack(tmp_path / "pack")


def test_converting_there_and_back_without_loss_gives_the_same_pack(pack, tmp_path, capsys):
    source = written(tmp_path / "a", pack.with_metadata(cameras=[1, 2]))
    assert main(["convert", str(source), "--out", str(tmp_path / "b.zip"), "--codec", "webp"]) == 0
    assert "% of" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "b.zip"), "--out", str(tmp_path / "c"), "--codec", "png"]) == 0
    assert same_pack(load_pack(tmp_path / "c"), pack)
    assert read_json(tmp_path / "c") == read_json(source), "no trace of the codec between"
    for file in images(source):
        assert (tmp_path / "c" / file.name).exists()


def test_converting_in_place_replaces_the_pack_and_with_a_lossy_codec_only_by_force(pack, tmp_path, refused):
    source = written(tmp_path / "a", pack)
    before = {file.name: file.read_bytes() for file in source.iterdir()}
    (tmp_path / "link").symlink_to(source)
    for out in (source, tmp_path / "link", source / "." / ".." / "a"):
        assert "avif is lossy" in refused(main, "convert", source, "--out", out, "--codec", "avif", "--quality", 40)
    assert before == {file.name: file.read_bytes() for file in source.iterdir()}
    assert main(["convert", str(source), "--out", str(source), "--codec", "webp"]) == 0
    assert main(["convert", str(source), "--out", str(source), "--codec", "avif", "--quality", "40", "--force"]) == 0
    assert {f.suffix for f in images(source)} == {".avif", ".xz"}
    assert read_json(source)["format"] == "avif"


def in_steps(pack: Pack, colour: int, feature: int, opacity: int = 1) -> Pack:
    """The pack with values rounded to steps, at most alpha."""
    alpha = np.minimum(-(pack.atlas_rgba[..., 3:].astype(int) // -opacity) * opacity, 255).astype(np.uint8)

    def rounded(values: np.ndarray, step: int) -> np.ndarray:
        return np.minimum(np.rint(values / step) * step, alpha).astype(np.uint8)

    rgba = np.concatenate([rounded(pack.atlas_rgba[..., :3], colour), alpha], axis=-1)
    return replace(pack, atlas_rgba=rgba, atlas_features=rounded(features_of(pack), feature))


@pytest.mark.parametrize("steps", [(4, 16), (4, 1), (1, 16), (3, 100), (4, 16, 4), (1, 1, 7)])
def test_webp_counts_in_the_steps_that_values_are_in_and_loses_nothing(pack, tmp_path, steps):
    coarse = in_steps(pack, *steps)
    save_pack(coarse, tmp_path / "pack", codec="webp")
    assert read_json(tmp_path / "pack")["snerg"]["codec_settings"]["steps"] == list(steps)
    assert same_pack(load_pack(tmp_path / "pack"), coarse)


def test_previews_come_before_the_end_and_at_it_lie_where_the_pack_does_and_the_pack_is_the_same(tmp_path):
    pack, seen, shares = toy_pack(), [], []
    save_pack(pack, tmp_path / "toy")
    read = load_pack(tmp_path / "toy", on_progress=lambda done, _: shares.append(done),
                     on_preview=lambda preview: seen.append((len(shares), preview)))  # fmt: skip
    assert seen[0][0] < shares[-1] == len(shares) == seen[-1][0]
    coarse = coarse_pack(pack, np.ones(len(pack.atlas_rgba), bool))
    assert coarse is not None
    np.testing.assert_array_equal(seen[-1][1].atlas_rgba, coarse.atlas_rgba)
    assert all(preview.atlas_rgba[..., 3].any() for _, preview in seen)
    assert coarse.voxel_size * coarse.block_size == pytest.approx(pack.voxel_size * pack.block_size)
    assert coarse.block_size < pack.block_size
    assert coarse.grid_blocks == pack.grid_blocks and coarse.atlas_blocks == pack.atlas_blocks
    assert np.all(coarse.max_xyz >= pack.max_xyz - 1e-9)
    np.testing.assert_array_equal(read.atlas_rgba, pack.atlas_rgba)
    np.testing.assert_array_equal(read.atlas_features, pack.atlas_features)
