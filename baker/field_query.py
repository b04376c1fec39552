"""Asking a trained field at any number of points, in batches of one fixed size so that nothing recompiles.

A batch is shared out over all local devices: its points are split among them, and the compiled query follows.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from training.method import FieldOutput
from training.run import Run

BATCH = 131_072

FieldQuery = Callable[[np.ndarray], FieldOutput]
Occupied = Callable[[np.ndarray, np.ndarray], np.ndarray]


def field_query(run: Run) -> FieldQuery:
    """A function from training-frame points [N, 3] to NumPy density [N], diffuse [N, 3], features [N, 4]."""
    devices = jax.local_devices()
    batch = BATCH * len(devices)
    split = NamedSharding(Mesh(np.array(devices), ("points",)), PartitionSpec("points"))

    def ask(points: np.ndarray) -> FieldOutput:
        parts = []
        for start in range(0, len(points), batch):
            part = points[start : start + batch]
            padded = np.zeros((batch, 3), np.float32)
            padded[: len(part)] = part
            placed = jnp.asarray(padded) if len(devices) == 1 else jax.device_put(padded, split)
            output = run.method.query(run.state, placed)
            parts.append([np.asarray(array)[: len(part)] for array in output])
        if not parts:
            return FieldOutput(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)))  # type: ignore[arg-type]
        return FieldOutput(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))  # type: ignore[arg-type]

    return ask


def occupied_query(run: Run) -> Occupied | None:
    """A function that says of training-frame boxes, low and high [N, 3], which may hold density; None where the field cannot
    tell without being asked everywhere, as an MLP cannot.
    """
    may_hold = getattr(run.method, "may_hold", None)
    return may_hold and (lambda low, high: may_hold(run.state, low, high))
