"""A field that can be written down: a solid, opaque, coloured ball. Baking it has known answers."""

from __future__ import annotations

import numpy as np

from training.method import FieldOutput

RADIUS, DENSITY = 0.8, 400.0
COLOUR = np.array([0.9, 0.5, 0.1])
FEATURES = np.array([0.2, 0.4, 0.6, 0.8])


def ball(points: np.ndarray) -> FieldOutput:
    """Density DENSITY within RADIUS of the origin, one colour and feature vector everywhere."""
    inside = np.linalg.norm(points, axis=-1) < RADIUS
    ones = np.ones((len(points), 1))
    return FieldOutput(inside * DENSITY, ones * COLOUR, ones * FEATURES)  # type: ignore[arg-type]


def nothing(points: np.ndarray) -> FieldOutput:
    """An empty field."""
    field = ball(points)
    return field._replace(density=np.zeros(len(points)))  # type: ignore[arg-type]
