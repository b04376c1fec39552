"""A checkpoint that somebody made, checksum and all, is refused by the name of the array, before a loop believes its indices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from console import UserError
from training.checkpoints import read_checkpoint
from training.voxels.checked import FARTHEST, MOST_RAYS, require_fitting
from training.voxels.saving import restore

OLDER = Path(__file__).parents[2] / "data" / "older" / "voxels" / "checkpoints" / "step_00001000.safetensors"
RAYS = 7 * 28 * 28  # training rays of that run


@pytest.fixture
def arrays() -> dict[str, np.ndarray]:
    return dict(read_checkpoint(OLDER)[1])


def test_a_checkpoint_of_an_older_version_fits(arrays: dict[str, np.ndarray]) -> None:
    require_fitting(arrays, RAYS, with_head=True)
    assert restore(arrays).cells.shape == arrays["cells"].shape


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("hits", [0, RAYS]), ("hits", [-1, 0]), ("hits", []), ("cells", [0, 91, 91]), ("cells", [0, 92, 91]), ("cells", [0, 0]),
        ("cells", [0, 729]), ("cells", []), ("cells", [0, -5]), ("cells", [0, 2**31 - 1]), ("dims", [7, 7, 0]),
        ("dims", [7, -7, -7]), ("dims", [2000, 2000, 2000]), ("dims", [2**31 - 1, 1, 1]), ("dims", [6, 7, 7]),
        ("voxel", [0, 1, 1]), ("voxel", [1, -1, 1]), ("voxel", [np.nan, 1, 1]), ("voxel", [1e-9, 1e-9, 1e-9]),
        ("origin", [np.inf, 0, 0]), ("origin", [10 * FARTHEST, 0, 0]), ("updates", -1),
        ("sizes", [5, 2607, 4096, 19, MOST_RAYS + 1]),
        ("sizes", [5, -1, 4096, 19, 768]), ("sizes", [5, 2**31 - 1, 4096, 19, 768]), ("hit_count", 0), ("hit_count", 2**31 - 1),
        ("hit_count", -1), ("step_voxels", 0.0), ("step_voxels", 2.0), ("step_voxels", np.nan),
    ],
)  # fmt: skip
def test_numbers_that_make_no_sense_are_refused(arrays: dict[str, np.ndarray], name: str, values: object) -> None:
    """RAYS where the list of hits is empty: then every ray is meant."""
    dtype = np.float32 if name == "step_voxels" else arrays.get(name, np.int32(0)).dtype
    arrays[name] = np.array(values, dtype)
    if name == "cells":
        for part in ("trainable", "first", "second"):
            arrays[f"{part}.rows"] = arrays[f"{part}.rows"][: len(arrays["cells"])]
    if name == "hits" and not len(arrays["hits"]):
        arrays["hit_count"] = np.int32(RAYS + 1)
    with pytest.raises(UserError, match=r'array "\w+" does not fit'):
        require_fitting(arrays, RAYS, with_head=True)


@pytest.mark.parametrize("change", ["shape", "type", "missing"])
def test_every_array_is_looked_at(arrays: dict[str, np.ndarray], change: str) -> None:
    for name, array in arrays.items():
        spoilt = {**arrays, name: array[None] if change == "shape" else array.astype(np.float64)}
        if change == "missing":
            del spoilt[name]
        with pytest.raises((UserError, KeyError), match=name):
            require_fitting(spoilt, RAYS, with_head=True)
            restore(spoilt)


def test_depths_of_another_grid_are_refused(arrays: dict[str, np.ndarray]) -> None:
    for depths in (arrays["depths"][1:], np.zeros_like(arrays["depths"])):
        with pytest.raises(UserError, match="depths"):
            restore({**arrays, "depths": depths})
