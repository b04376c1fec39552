"""Procedural scenes."""

import numpy as np
import pytest

from tools.procedural.__main__ import procedural
from training.scenes import load_scene


@pytest.mark.slow
@pytest.mark.parametrize("name", ["glass", "wires"])
def test_the_program_writes_each_arrangement(name, tmp_path):
    procedural(tmp_path / "a", scene=name, size=16, views=2, subpixels=1)
    assert {split: len(views) for split, views in load_scene(tmp_path / "a").splits.items()} == {"train": 2, "test": 2}
    procedural(tmp_path / "b", size=16, views=2, subpixels=1)
    one, other = (load_scene(tmp_path / folder).splits["train"][0].load() for folder in "ab")
    assert not np.array_equal(one, other), "it is not the demo's"
