"""A small glossy scene, the same each time: a shell, a ring, thin rods and a checkered plate with some fog above.

Everything comes from formulas, so that golden pictures do not depend on a random generator's version.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from scenepack.constants import VIEW_MLP_WIDTHS
from scenepack.contraction import uncontract
from scenepack.pack import Pack, ViewMlp
from tests.scenepack.volumes import BLENDER_FRAME, NDC_FRAME, cube_pack

FLOOR, BALL, SKY = -0.8, (3.0, 0.6, -2.0, 1.2), 20.0  # of surroundings_pack, units of R


def glossy_mlp() -> ViewMlp:
    """A view MLP with visible highlights; its weights are scrambled sines, spread evenly about zero."""
    weights, biases = [], []
    for layer, (inputs, outputs) in enumerate(pairwise(VIEW_MLP_WIDTHS)):
        i, j = np.indices((inputs + 1, outputs))
        scrambled = 2.0 * np.modf(np.abs(np.sin(12.9898 * i + 78.233 * j + 37.719 * layer)) * 43758.5453)[0] - 1.0
        weights.append((scrambled[:-1] * 2.6 / np.sqrt(inputs)).astype(np.float32))
        biases.append((0.3 * scrambled[-1] - (0.8 if layer == 2 else 0.0)).astype(np.float32))
    return ViewMlp((weights[0], weights[1], weights[2]), (biases[0], biases[1], biases[2]))


def opacity(x: np.ndarray, y: np.ndarray, z: np.ndarray, voxel: float) -> np.ndarray:
    """Opacity a voxel of the scene within [-1, 1]^3; surfaces are about two voxels thick."""
    shell = np.abs(np.sqrt((x - 0.25) ** 2 + (y - 0.1) ** 2 + (z - 0.1) ** 2) - 0.36)
    ring = np.abs(np.hypot(np.hypot(x + 0.4, z + 0.3) - 0.36, y - 0.0) - 0.12)
    rods = np.minimum(np.hypot(x + 0.75, z - 0.7), np.hypot(y - 0.6, z - 0.7)) - 0.02
    rods = np.maximum(rods, np.maximum(np.abs(x), np.abs(y)) - 0.8)
    plate = np.maximum(np.abs(y + 0.6) - 0.05, np.maximum(np.abs(x), np.abs(z)) - 0.9)
    distance = np.minimum.reduce([shell, ring, np.maximum(rods, 0), np.abs(plate)])
    solid = np.clip(1.4 - distance / voxel, 0, 1) ** 2
    fog = 0.02 * (np.abs(y + 0.4) < 0.08) * (np.hypot(x + 0.5, z - 0.4) < 0.3)
    return np.maximum(solid, fog)


def shapes_pack(side: int = 70, block_size: int = 14, *, ndc: bool = False, diffuse: bool = False) -> Pack:
    """The scene as a pack of side^3 voxels over [-1, 1]^3; ndc: taken as the warped space of a forward-facing pack."""
    voxel = 2.0 / side
    centres = (np.arange(side) + 0.5) * voxel - 1.0
    x, y, z = centres[None, None, :], centres[None, :, None], centres[:, None, None]
    alpha = opacity(x, y, z, voxel)
    checks = 0.3 + 0.5 * ((np.floor(x * 5) + np.floor(z * 5) + np.floor(y * 5)) % 2)
    colour = np.stack(np.broadcast_arrays(checks, 0.5 + 0.3 * np.sin(5 * y), 0.5 + 0.3 * np.cos(4 * z + x)), axis=-1)
    waves = 0.5 + 0.5 * np.sin(3 * x), 0.5 + 0.5 * np.cos(3 * y), 0.5 + 0.5 * np.sin(4 * z), 0.5
    features = np.stack(np.broadcast_arrays(*waves), axis=-1)
    levels = np.rint(255 * alpha)[..., None]
    rgba = np.concatenate([np.rint(0.7 * colour * levels), levels], axis=-1).astype(np.uint8)
    camera = {"ndc": True, "input_width": 160.0, "input_height": 120.0, "input_focal": 140.0} if ndc else {}
    shading = {} if diffuse else {"features": np.rint(features * levels).astype(np.uint8), "view_mlp": glossy_mlp()}
    return cube_pack(rgba, block_size, NDC_FRAME if ndc else BLENDER_FRAME, **shading, **camera)


def surroundings_pack(side: int = 128, *, radius: float = 1.0, diffuse: bool = False) -> Pack:
    """A contracted pack of side^3 voxels over all of space. In units of R = radius: the scene above in the inner cube, a
    chequered floor at y = FLOOR out to infinity, a red ball (BALL: x, y, z, radius), and a sky of radius SKY.
    """
    voxel = 4.0 / side
    centres = (np.arange(side) + 0.5) * voxel - 2.0
    u = np.stack(np.broadcast_arrays(centres[None, None, :], centres[None, :, None], centres[:, None, None]), axis=-1)
    x, y, z = np.moveaxis(uncontract(u), -1, 0)
    inside = (np.abs(u).max(-1) < 0.95) * opacity(x, y, z, voxel)
    floor = _solid(y - FLOOR)
    ball = _solid(np.sqrt((x - BALL[0]) ** 2 + (y - BALL[1]) ** 2 + (z - BALL[2]) ** 2) - BALL[3])
    away = np.sqrt(x * x + y * y + z * z)
    sky, height = _solid(SKY - away), y / away
    alpha = np.maximum.reduce([inside, floor, ball, sky])
    checks = 0.25 + 0.5 * ((np.floor(x) + np.floor(z)) % 2)
    colours = {
        "inside": (0.9, 0.6 + 0.3 * np.sin(5 * y), 0.2), "ball": (0.8, 0.15, 0.1 + 0.1 * np.sign(y - BALL[1])),
        "sky": (0.75 - 0.5 * height, 0.85 - 0.4 * height, 1.0), "floor": (checks, checks, 0.8 * checks),
    }  # fmt: skip
    rgb = np.zeros(u.shape)
    for name, part in (("floor", floor), ("sky", sky), ("ball", ball), ("inside", inside)):
        rgb = np.where((part >= alpha)[..., None], np.stack(np.broadcast_arrays(*colours[name], x)[:3], -1), rgb)
    levels = np.rint(255 * alpha)[..., None]
    rgba = np.concatenate([np.rint(0.6 * rgb * levels), levels], axis=-1).astype(np.uint8)
    waves = 0.5 + 0.5 * np.sin(3 * np.stack([x, y, z, x], -1) / (1 + away[..., None]))
    features = np.rint(waves * levels).astype(np.uint8)
    pack = cube_pack(rgba, 14, **({} if diffuse else {"features": features, "view_mlp": glossy_mlp()}))
    pack = replace(pack, voxel_size=radius * voxel, min_xyz=np.full(3, -2.0 * radius))
    return pack.with_metadata(contraction=radius)


def _solid(distance: np.ndarray) -> np.ndarray:
    """Opacity where `distance` to a surface is negative; its edge is about a voxel wide after the contraction."""
    slope = np.sqrt(sum(np.square(np.gradient(distance, axis=axis)) for axis in range(3)))
    return np.clip(1.0 - distance / np.maximum(slope, 1e-9), 0, 1) ** 2
