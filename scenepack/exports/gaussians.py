"""Voxels as 3D Gaussians, in the layout that splat viewers read (Kerbl et al. 2023, "3D Gaussian Splatting").

One round Gaussian for each voxel, without any dependence on the viewing direction: f_dc only, which stands for the diffuse
colour. Viewers splat a Gaussian as o g(d): its opacity o, and g(d) = exp(-d^2 / 2 s^2) at distance d of the ray. A plane of
voxels of opacity a must let as much pass as the pack does, so that o is chosen such that 1 - a is the mean, over where the ray
pierces the plane, of the product of 1 - o g over the plane's voxels.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from scenepack.exports.export_frame import ExportFrame
from scenepack.exports.field import Field
from scenepack.exports.ply import Column

SIGMA = 0.5  # of a Gaussian, in voxels
SH_0 = 0.28209479177387814  # the spherical harmonic of degree 0
MOST_OPACITY = 0.99
COLUMNS: tuple[Column, ...] = tuple(
    (name, "f4")
    for name in (
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
        *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    )
)


def voxels_of(field: Field, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions float64 [n, 3] (x, y, z in voxels of the pack) and premultiplied rgba float32 [n, 4], of opacity >= least."""
    places: list[np.ndarray] = [np.zeros((0, 3))]
    values: list[np.ndarray] = [np.zeros((0, 4), np.float32)]
    for place in field.occupied:
        cells = field.block(place)
        if cells is None:
            continue
        at = np.argwhere(cells[..., 3] >= least)
        values.append(cells[tuple(at.T)])
        places.append(field.coarser * (at + np.asarray(place) * field.side + 0.5)[:, ::-1])
    return np.concatenate(places), np.concatenate(values)


def gaussian_values(
    positions: np.ndarray, rgba: np.ndarray, field: Field, export_frame: ExportFrame
) -> list[np.ndarray]:
    """What fills COLUMNS: position, no normal, colour, opacity before the sigmoid, logarithms of sizes, no rotation."""
    straight = np.clip(rgba[:, :3] / np.maximum(rgba[:, 3:], 1e-6), 0.0, 1.0)
    alphas, opacities = opacity_table()
    opacity = np.clip(np.interp(rgba[:, 3], alphas, opacities), 1e-3, MOST_OPACITY)[:, None]
    count = len(positions)
    sizes = SIGMA * field.coarser * export_frame.sizes(positions)
    return [
        export_frame.points(positions),
        np.zeros((count, 3)),
        (straight - 0.5) / SH_0,
        np.log(opacity / (1.0 - opacity)),
        np.log(sizes),
        np.broadcast_to([1.0, 0.0, 0.0, 0.0], (count, 4)),
    ]


@cache
def opacity_table() -> tuple[np.ndarray, np.ndarray]:
    """Opacities of a plane of voxels, rising, and the Gaussians' own that give them."""
    across = (np.arange(16) + 0.5) / 16 - 0.5
    reach = np.arange(-3, 4)
    distance = (across[:, None] - reach) ** 2  # [pierced at, voxel]
    passes = np.exp(-(distance[:, None, :, None] + distance[None, :, None, :]) / (2 * SIGMA**2))
    own = np.linspace(0.0, MOST_OPACITY, 100)
    return np.array([1.0 - np.prod(1.0 - o * passes, axis=(2, 3)).mean() for o in own]), own
