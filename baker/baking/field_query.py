"""Asking a trained field at any number of points, in batches of one fixed size so that nothing recompiles.

Local devices take batches in turn, each with a copy of the field; they work at the same time, since JAX does not wait.
"""

from collections.abc import Callable

import jax
import numpy as np

from training.devices import here
from training.method import FieldOutput
from training.run import Run

BATCH = 131_072

FieldQuery = Callable[[np.ndarray], FieldOutput]
Occupied = Callable[[np.ndarray, np.ndarray], np.ndarray | None]


def field_query(run: Run) -> FieldQuery:
    """A function from training-frame points [N, 3] to NumPy density [N], diffuse [N, 3], features [N, 4]."""
    devices = jax.local_devices()
    states = [run.state]
    if len(devices) > 1:
        own = here(run.state)
        states = [
            jax.tree.map(lambda v, d=d: jax.device_put(v, d) if isinstance(v, jax.Array) else v, own) for d in devices
        ]

    def ask(points: np.ndarray) -> FieldOutput:
        parts = []
        for turn, start in enumerate(range(0, max(len(points), 1), BATCH)):
            part = np.asarray(points[start : start + BATCH], np.float32)
            padded = np.pad(part, ((0, BATCH - len(part)), (0, 0)))
            device = turn % len(devices)
            parts.append(run.method.query(states[device], jax.device_put(padded, devices[device])))
            if turn >= len(devices):  # no more than one batch waits for each device
                parts[turn - len(devices)] = jax.device_get(parts[turn - len(devices)])
        arrays = zip(*jax.device_get(parts), strict=True)
        return FieldOutput(*(np.concatenate(some)[: len(points)] for some in arrays))  # type: ignore[arg-type]

    return ask


def within(query: FieldQuery, box: np.ndarray) -> FieldQuery:
    """The field of `query` inside a training-frame box [2, 3], and no density outside."""

    def ask(points: np.ndarray) -> FieldOutput:
        field = query(points)
        inside = np.all((points >= box[0]) & (points <= box[1]), axis=-1)
        return field._replace(density=np.where(inside, field.density, 0))  # type: ignore[arg-type]

    return ask
