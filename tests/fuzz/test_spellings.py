"""Scenes written otherwise have the same rays; `python -m tests.fuzz.spellings` tries more."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz.spellings import trial


@pytest.mark.filterwarnings("ignore::console.Notice")
def test_a_scene_has_the_same_rays_however_it_is_written(tmp_path: Path):
    assert {seed: found for seed in range(30) if (found := trial(seed, tmp_path / str(seed)))} == {}
