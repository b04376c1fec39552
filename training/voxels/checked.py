"""Arrays of a checkpoint, checked before a state is made of them: compiled loops believe every index that they are given.

A checksum tells damage by chance; it cannot tell a file that somebody made, or that belongs to other photographs.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from console import UserError
from scenepack.constants import VIEW_MLP_WIDTHS
from training.exposure import GAINS
from training.plausible import BETWEEN_SAMPLES
from training.voxels.sparse_grid import CHANNELS

# Of each array: its shape, -1 standing for any length, and its type (see _require).
SHAPES = (
    ("origin", (3,), "f"), ("voxel", (3,), "f"), ("dims", (3,), "i"), ("updates", (), "i"), ("sizes", (5,), "i"),
    ("cells", (-1,), "i"), ("hits", (-1,), "i"), ("depths", (-1,), "u"),
)  # fmt: skip
PARTS = ("trainable", "first", "second")
# Cells of the grid for each voxel, at most: 135 is usual at 512³. What is beyond would be gigabytes out of a small file.
CELLS_PER_VOXEL, FEWEST_CELLS = 4096, 1 << 20
FARTHEST = 1e6  # from the origin, in voxels: float32 tells no halves of them beyond
MOST_RAYS, LONGEST_LIST = 1 << 22, 1 << 26  # of a step


def require_fitting(
    arrays: Mapping[str, np.ndarray], rays: int, *, with_head: bool, photographs: int | None = None
) -> None:
    """UserError, naming the array, unless they make up a state of a scene with so many training rays. KeyError where one is
    missing. with_head: a view MLP is trained, too. photographs: as many have gains; None where none are fitted.
    A run of before there were gains has none of them."""
    for name, shape, kind in SHAPES:
        _require(arrays, name, shape, kind)
    rows = len(arrays["cells"])
    for part in PARTS:
        _require(arrays, f"{part}.rows", (rows, CHANNELS), "f")
        for layer, (inputs, outputs) in enumerate(pairwise(VIEW_MLP_WIDTHS)) if with_head else ():
            _require(arrays, f"{part}.weight{layer}", (inputs, outputs), "f")
            _require(arrays, f"{part}.bias{layer}", (outputs,), "f")
    _require_grid(arrays)
    _require_rays(arrays, rays)
    if "gains" in arrays:
        _require_gains(arrays, photographs)


def _require_grid(arrays: Mapping[str, np.ndarray]) -> None:
    dims, cells = arrays["dims"].astype(np.int64), arrays["cells"].astype(np.int64)
    most = min(FEWEST_CELLS + CELLS_PER_VOXEL * len(cells), 2**31 - 1)
    if (dims < 1).any() or (dims > most).any() or np.prod((dims + 2).astype(float)) > most:
        raise unfit("dims", f"sides from 1 on, {most} cells in all", dims.tolist())
    voxel, origin = arrays["voxel"], arrays["origin"]
    if (voxel <= 0).any() or (np.abs(origin) > FARTHEST * voxel).any():
        raise unfit("voxel", "a size above 0, near the origin", voxel.tolist())
    z, y, x = np.unravel_index(np.clip(cells[1:], 0, np.prod(dims + 2) - 1), tuple(dims[::-1] + 2))
    within = [(place >= 1) & (place <= side) for place, side in zip((x, y, z), dims, strict=True)]
    if not len(cells) or not np.all(within) or (np.diff(cells[1:]) <= 0).any() or cells[-1] >= np.prod(dims + 2):
        raise unfit("cells", "voxels within the grid, in order", "others")


def _require_rays(arrays: Mapping[str, np.ndarray], rays: int) -> None:
    hits = arrays["hits"]
    _require({"hit_count": np.asarray(arrays.get("hit_count", np.int32(len(hits))))}, "hit_count", (), "i")
    if len(hits) > rays:
        raise unfit("hits", f"at most {rays} rays", len(hits))
    count = int(arrays.get("hit_count", len(hits)))
    if not 1 <= count <= (len(hits) or rays):
        raise unfit("hit_count", f"1 to {len(hits) or rays}", count)
    if len(hits) and (hits.min() < 0 or hits.max() >= rays):
        raise unfit("hits", f"rays below {rays}", f"{hits.min()} to {hits.max()}")
    if int(arrays["updates"]) < 0:
        raise unfit("updates", "a count", int(arrays["updates"]))
    step = np.asarray(arrays.get("step_voxels", np.float32(1.0)))
    _require({"step_voxels": step}, "step_voxels", (), "f")
    finest, farthest = BETWEEN_SAMPLES
    if not finest <= float(step) <= farthest:
        raise unfit("step_voxels", f"{finest:g} to {farthest:g}", float(step))
    _require({"closed": np.asarray(arrays.get("closed", np.int32(0)))}, "closed", (), "i")
    *lists, drawn = (int(n) for n in arrays["sizes"])
    unknown = not any(lists)  # as of an engine that has no lists; otherwise a step marches through all of them
    if min(*lists, drawn) < (0 if unknown else 1) or max(lists) > LONGEST_LIST or drawn > MOST_RAYS:
        expected = f"lists of 1 to {LONGEST_LIST}, or none, and rays up to {MOST_RAYS}"
        raise unfit("sizes", expected, arrays["sizes"].tolist())


def _require_gains(arrays: Mapping[str, np.ndarray], photographs: int | None) -> None:
    if photographs is None:
        raise unfit("gains", "none: exposures are not fitted", "some")
    _require(arrays, "gains", (photographs, 3), "f")
    low, high = GAINS
    if arrays["gains"].min() < np.float32(low) or arrays["gains"].max() > np.float32(high):
        raise unfit("gains", f"{low} to {high}", f"{arrays['gains'].min():g} to {arrays['gains'].max():g}")


def _require(arrays: Mapping[str, np.ndarray], name: str, shape: tuple[int, ...], kind: str) -> None:
    """An array of that shape (-1: any length), of float32, int32 or uint8 ("f", "i", "u"), and finite."""
    array, dtype = arrays[name], {"f": np.float32, "i": np.int32, "u": np.uint8}[kind]
    fits = array.ndim == len(shape) and all(side in (-1, n) for side, n in zip(shape, array.shape, strict=True))
    if not fits or array.dtype != dtype:
        sides = [side if side >= 0 else "…" for side in shape]
        raise unfit(name, f"{np.dtype(dtype)} {sides}", f"{array.dtype} {list(array.shape)}")
    if not np.isfinite(array).all():
        raise unfit(name, "finite numbers", "NaN or infinity")


def unfit(name: str, expected: object, found: object) -> UserError:
    return UserError(
        f'array "{name}" does not fit', where="checkpoint", expected=expected, found=found,
        remedy="the file is damaged, or belongs to another run or other photographs",
    )  # fmt: skip
