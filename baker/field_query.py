"""Asking a trained field at any number of points, in batches of one fixed size so that nothing recompiles."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from training.method import FieldOutput
from training.run import Run

BATCH = 131_072

FieldQuery = Callable[[np.ndarray], FieldOutput]
Occupied = Callable[[np.ndarray, np.ndarray], np.ndarray]


def field_query(run: Run) -> FieldQuery:
    """A function from training-frame points [N, 3] to NumPy density [N], diffuse [N, 3], features [N, 4]."""

    def ask(points: np.ndarray) -> FieldOutput:
        parts = []
        for start in range(0, len(points), BATCH):
            part = points[start : start + BATCH]
            padded = np.zeros((BATCH, 3), np.float32)
            padded[: len(part)] = part
            output = run.method.query(run.state, jnp.asarray(padded))
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
