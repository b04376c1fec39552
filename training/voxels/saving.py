"""A VoxelState as named arrays, and back: the form in which checkpoints hold it."""

from __future__ import annotations

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np

from training.marching.march import MarchSizes
from training.method import ViewMlpParams
from training.voxels.checked import unfit
from training.voxels.sparse_grid import build_layout
from training.voxels.state import Trainable, VoxelState

UNKNOWN = MarchSizes(0, 0, 0, 0)  # sizes that no engine has asked for yet


def save(state: VoxelState) -> dict[str, np.ndarray]:
    """Named arrays: what `restore` cannot derive."""
    support = np.asarray(state.layout.support)
    arrays = {
        "origin": state.layout.origin, "voxel": state.layout.voxel, "dims": state.layout.dims,
        "depths": support[support > 0],
        "cells": state.cells, "hits": state.hits[: int(state.hit_count)], "hit_count": state.hit_count,
        "updates": state.updates,
        "step_voxels": np.float32(state.step_voxels),
        "closed": np.int32(state.closed),
        "sizes": np.array([*(state.sizes or UNKNOWN), state.rays], np.int32),
    }  # fmt: skip
    if state.gains is not None:
        arrays["gains"] = state.gains
    for name in ("trainable", "first", "second"):
        part = getattr(state, name)
        arrays[f"{name}.rows"] = part.rows
        if part.head is not None:
            arrays |= {f"{name}.weight{i}": w for i, w in enumerate(part.head.weights)}
            arrays |= {f"{name}.bias{i}": b for i, b in enumerate(part.head.biases)}
    return {name: np.asarray(array, order="C") for name, array in arrays.items()}


def restore(arrays: Mapping[str, np.ndarray]) -> VoxelState:
    """The inverse of save, of arrays that fit (training.voxels.checked). KeyError where one is missing."""
    width, height, depth = (int(n) for n in arrays["dims"])
    padded = np.zeros((depth + 2, height + 2, width + 2), bool)
    padded.ravel()[arrays["cells"][1:]] = True
    layout = build_layout(padded[1:-1, 1:-1, 1:-1], arrays["origin"], arrays["voxel"])
    support = layout.support > 0
    if len(arrays["depths"]) != int(support.sum()) or not arrays["depths"].all():
        raise unfit("depths", f"{int(support.sum())} optical depths", len(arrays["depths"]))
    layout = layout._replace(support=layout.support.at[support].set(jnp.asarray(arrays["depths"])))
    parts = {}
    for name in ("trainable", "first", "second"):
        head = None
        if f"{name}.weight0" in arrays:
            head = ViewMlpParams(
                tuple(jnp.asarray(arrays[f"{name}.weight{i}"]) for i in range(3)),  # type: ignore[arg-type]
                tuple(jnp.asarray(arrays[f"{name}.bias{i}"]) for i in range(3)),  # type: ignore[arg-type]
            )
        parts[name] = Trainable(jnp.asarray(arrays[f"{name}.rows"]), head)
    *sizes, rays = (int(n) for n in arrays["sizes"])
    sizes = MarchSizes(*sizes)
    return VoxelState(
        **parts, updates=jnp.asarray(arrays["updates"]), layout=layout, cells=jnp.asarray(arrays["cells"]),
        hits=jnp.asarray(arrays["hits"]), hit_count=jnp.int32(arrays.get("hit_count", len(arrays["hits"]))),
        sizes=None if sizes == UNKNOWN else sizes, rays=rays, step_voxels=float(arrays.get("step_voxels", 1.0)),
        closed=bool(arrays.get("closed", 0)), gains=arrays.get("gains"),
    )  # fmt: skip
