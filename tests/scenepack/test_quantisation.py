"""Values in coarse steps: a lossless codec counts them in steps, and loses nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenepack import Pack, load_pack, save_pack
from scenepack.codecs.quantisation import EXACT, steps_of
from tests.scenepack.helpers import images, read_json, same_pack, smooth_pack


@pytest.fixture(scope="module")
def pack() -> Pack:
    return smooth_pack()


def in_steps(pack: Pack, colour: int, feature: int, opacity: int = 1) -> Pack:
    """The pack with values rounded to steps, at most alpha."""
    alpha = np.minimum(-(pack.atlas_rgba[..., 3:].astype(int) // -opacity) * opacity, 255).astype(np.uint8)
    assert pack.atlas_features is not None

    def rounded(values: np.ndarray, step: int) -> np.ndarray:
        return np.minimum(np.rint(values / step) * step, alpha).astype(np.uint8)

    rgba = np.concatenate([rounded(pack.atlas_rgba[..., :3], colour), alpha], axis=-1)
    return replace(pack, atlas_rgba=rgba, atlas_features=rounded(pack.atlas_features, feature))


@pytest.mark.parametrize("steps", [(4, 16), (4, 1), (1, 16), (3, 100), (4, 16, 4), (1, 1, 7)])
def test_webp_counts_in_the_steps_that_values_are_in_and_loses_nothing(
    pack: Pack, tmp_path: Path, steps: tuple[int, ...]
) -> None:
    coarse = in_steps(pack, *steps)
    save_pack(coarse, tmp_path / "pack", codec="webp")
    assert read_json(tmp_path / "pack")["snerg"]["codec_settings"]["steps"] == list(steps)
    assert same_pack(load_pack(tmp_path / "pack"), coarse)


def test_what_is_counted_in_steps_takes_fewer_bytes(
    pack: Pack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = []
    for found in (steps_of, lambda *_: EXACT):
        monkeypatch.setattr("scenepack.piece_files.steps_of", found)
        save_pack(in_steps(pack, 4, 16), tmp_path / "pack", codec="webp")
        sizes.append(sum(f.stat().st_size for f in images(tmp_path / "pack")))
    assert sizes[0] < 0.97 * sizes[1]
