"""What is up, where the user says it (--up): a reconstruction does not know, and cameras that look down lean.

The direction is one of the training frame as it is without the option: the frame that the window shows, and that --aabb is in.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from console import UserError
from console.arguments import parse_numbers
from training.scenes.poses import normalised
from training.scenes.scene import Direction

OPTION = "--up"
SHORTEST = 1e-6


def parse_up(text: str) -> Direction:
    """ "x,y,z" as a direction. UserError for anything else."""
    return checked_up(parse_numbers(text, 3, OPTION))


def checked_up(values: Sequence[float]) -> Direction:
    """Three finite numbers, not all 0. UserError for anything else."""
    try:
        numbers = np.array(values, np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all() or np.linalg.norm(numbers) < SHORTEST:
        raise UserError("is no direction", where=OPTION, expected="x,y,z, not all 0", found=str(values)[:60])
    x, y, z = map(float, numbers)
    return x, y, z


def axes_of(up: Direction) -> np.ndarray:
    """Axes [3, 3] (columns), in the frame without the option, of the frame whose z is `up`: turned there the shortest way."""
    z = normalised(np.array(checked_up(up)))
    if z[2] < -1 + SHORTEST:
        return np.diag([1.0, -1.0, -1.0])
    x, y, height = z
    across = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])  # Rodrigues' formula, about (-y, x, 0)
    return np.eye(3) + across + across @ across / (1.0 + height)


def composed(before: Direction | None, up: np.ndarray) -> Direction:
    """The option for what is up in the frame that another value of it has led to."""
    x, y, z = (float(f"{value:.5g}") for value in (up if before is None else axes_of(before) @ up))
    return x, y, z
