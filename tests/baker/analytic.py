"""A field that can be written down: a solid, opaque, coloured ball. Baking it has known answers."""

import numpy as np

from baker.baking.culling import Culling, opaque_macroblocks, seen_macroblocks
from baker.baking.field_query import FieldQuery
from baker.baking.grid import BakeGrid
from baker.baking.work_folder import WorkFolder
from training.dataset import RayDataset
from training.method import FieldOutput

RADIUS, DENSITY = 0.8, 400.0
COLOUR = np.array([0.9, 0.5, 0.1])
FEATURES = np.array([0.2, 0.4, 0.6, 0.8])


def ball(points: np.ndarray) -> FieldOutput:
    """Density DENSITY within RADIUS of the origin, one colour and feature vector everywhere."""
    inside = np.linalg.norm(points, axis=-1) < RADIUS
    ones = np.ones((len(points), 1))
    return FieldOutput(inside * DENSITY, ones * COLOUR, ones * FEATURES)  # type: ignore[arg-type]


def culled(field: FieldQuery, grid: BakeGrid, dataset: RayDataset, work: WorkFolder | None = None) -> Culling:
    """What of a grid is worth storing, by both tests."""
    opacity = opaque_macroblocks(field, grid, lambda low, high: None, lambda share: None, work)
    return seen_macroblocks(opacity, grid, dataset, lambda share: None, work)
