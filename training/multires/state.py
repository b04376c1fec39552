"""The state of the field: plain arrays, whichever engine makes its steps; in checkpoints, checked: compiled loops believe every
index that they are given."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from training.checkpoints import misfit, type_and_shape
from training.exposure import GAINS
from training.multires.field import VIEW_PARAMETERS, decoder_size, inputs_of
from training.multires.levels import ALL_HASHED, FEATURES, HASHED_FROM, bricks_along, is_dense, make_levels


class Box(NamedTuple):
    """Where the unit cube is."""

    origin: np.ndarray  # float64 [3]: its low corner in the training frame
    cell: np.ndarray  # float64 [3]: sides of a cell of the occupancy grid, in world units
    dims: np.ndarray  # int32 [3] = (x, y, z): cells that the scene's box fills; beyond them nothing is


PARTS = ("values", "first", "second")  # of a State: Trainable
AVERAGES = 20  # states that the mean is of, in the end


class Trainable(NamedTuple):
    """Values, or Adam's moments of them."""

    table: Any  # [E, 4]: features by row (training.multires.levels)
    parameters: Any  # [P]: of decoder and view MLP (training.multires.field)


@dataclass
class State:
    """All that changes between steps, and where the field lies."""

    box: Box
    bricks: tuple[np.ndarray | None, ...]  # of each level, int32, the bricks present; None where it has not joined
    values: Trainable
    first: Trainable  # Adam's moments of the values
    second: Trainable
    codes: np.ndarray  # uint8 [R, R, R]: see training.multires.occupancy
    updates: int  # steps made
    next_ray: int  # its number in the order in which pixels are drawn (training.dataset.evenly_spread)
    samples_per_ray: float  # of late
    step_cells: float  # distance between samples, in cells of the occupancy grid
    gains: np.ndarray | None = None  # float32 [V, 3]: of the photographs (training.exposure)
    mean: Trainable | None = (
        None  # of the values after `averaged` of the last steps: what the field shows once there is one
    )
    averaged: int = 0
    # what an engine derives from the rest; never saved
    kept: dict[str | float, Any] = field(default_factory=dict, repr=False, compare=False)


MOST_SAMPLES = 1e6  # of a ray


def saved(state: State, resolutions: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Named arrays, from which `restored` makes the state again."""
    arrays: dict[str, np.ndarray] = {
        "origin": state.box.origin, "cell": state.box.cell, "dims": state.box.dims, "codes": state.codes,
        "updates": np.int64(state.updates), "next_ray": np.int64(state.next_ray),
        "samples_per_ray": np.float64(state.samples_per_ray), "step_cells": np.float64(state.step_cells),
    }  # type: ignore[dict-item]  # fmt: skip
    for part in PARTS:
        arrays[f"{part}.table"], arrays[f"{part}.parameters"] = getattr(state, part)
    for resolution, present in zip(resolutions, state.bricks, strict=True):
        if present is not None:
            arrays[f"bricks.{resolution}"] = present
    if state.gains is not None:
        arrays["gains"] = state.gains
    if state.mean is not None:
        arrays["mean.table"], arrays["mean.parameters"] = state.mean
        arrays["averaged"] = np.array(state.averaged)
    return {name: np.asarray(array, order="C") for name, array in arrays.items()}


def restored(arrays: Mapping[str, np.ndarray], resolutions: tuple[int, ...], side: int, views: int | None) -> State:
    """The inverse of saved. side: of the occupancy grid. views: as many have gains; None where none are fitted.

    UserError, naming the array, where one does not fit; KeyError where one is missing.
    """

    def array(
        name: str, shape: tuple[int, ...], dtype: type = np.float32, least: float | None = None, most: float = np.inf
    ) -> np.ndarray:
        found = arrays[name]
        if found.shape != shape or found.dtype != dtype:
            raise misfit(name, type_and_shape(np.empty(shape, dtype)), type_and_shape(found))
        if found.dtype.kind == "f" and not np.isfinite(found).all():
            raise misfit(name, "finite numbers", "NaN or infinity")
        if least is not None and (found.min() < least or found.max() > most):
            raise misfit(name, f"{least:g} to {most:g}", f"{found.min():g} to {found.max():g}")
        return found

    box = Box(
        array("origin", (3,), np.float64), array("cell", (3,), np.float64, 1e-9, 1e9), array("dims", (3,), np.int32, 1, side)
    )  # fmt: skip
    bricks = tuple(_bricks(arrays, resolution) for resolution in resolutions)
    rows = make_levels(resolutions, bricks).total
    parameters = decoder_size(inputs_of(len(resolutions))) + VIEW_PARAMETERS
    has_mean = "averaged" in arrays
    values, first, second, *mean = (
        Trainable(array(f"{part}.table", (rows, FEATURES)), array(f"{part}.parameters", (parameters,)))
        for part in (*PARTS, *("mean",) * has_mean)
    )
    fewest, most = (float(np.float32(limit)) for limit in GAINS)
    return State(
        box, bricks, values, first, second, array("codes", (side, side, side), np.uint8),
        updates=int(array("updates", (), np.int64, 0, 2**40)),
        next_ray=int(array("next_ray", (), np.int64, 0, 2**60)),
        samples_per_ray=float(array("samples_per_ray", (), np.float64, 0.0, MOST_SAMPLES)),
        step_cells=float(array("step_cells", (), np.float64, 0.01, 2.0)),
        gains=None if views is None else array("gains", (views, 3), np.float32, fewest, most),
        mean=mean[0] if has_mean else None,
        averaged=int(array("averaged", (), np.int64, 1, AVERAGES)) if has_mean else 0,
    )  # fmt: skip


def _bricks(arrays: Mapping[str, np.ndarray], resolution: int) -> np.ndarray | None:
    name = f"bricks.{resolution}"
    if name not in arrays:
        return None
    present = arrays[name]
    if resolution > HASHED_FROM and np.array_equal(present, ALL_HASHED):
        return ALL_HASHED
    expected = np.empty(0 if is_dense(resolution) else present.size, np.int32)
    if present.shape != expected.shape or present.dtype != expected.dtype:
        raise misfit(name, type_and_shape(expected), type_and_shape(present))
    if (present < 0).any() or (present >= bricks_along(resolution) ** 3).any() or (np.diff(present) <= 0).any():
        raise misfit(name, "bricks of the cube, in order", "others")
    return present
