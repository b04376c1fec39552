"""Photographs of a textured room, most of one corner, by cameras that are known: what finds poses must find these."""

from functools import lru_cache
from itertools import product

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from training.scenes import Camera
from training.scenes.lens import MODELS
from training.scenes.poses import look_at
from training.scenes.scene import camera_rays

SIZE, FOCAL = (256, 192), 268.8  # pixels
TILE = 512  # pixels of a wall's texture, over WALL units of length
WALL = 4.0


@lru_cache
def texture(seed: int) -> np.ndarray:
    """Noise at many scales, uint8-like float32 [TILE, TILE, 3]: features everywhere, none like another."""
    rng = np.random.default_rng(seed)
    out = np.zeros((TILE, TILE, 3), np.float32)
    for cells in (8, 16, 32, 64, 128, 256):
        noise = Image.fromarray(rng.integers(0, 256, (cells, cells, 3), np.uint8))
        out += np.asarray(noise.resize((TILE, TILE), Image.Resampling.BICUBIC), np.float32) / 6
    return np.clip((out - 128) * 1.6 + 128, 0, 255)


def cameras(count: int) -> list[Camera]:
    """Cameras on an arc, looking into the corner at the origin from (1, 1, 1)."""
    out = []
    for angle in np.linspace(-0.45, 0.45, count):
        turn = np.pi / 4 + angle
        eye = np.array([3.2 * np.cos(turn), 3.2 * np.sin(turn), 1.6 + 0.5 * np.sin(7 * angle)])
        pose = look_at(eye, eye - np.array([0.6, 0.6, 0.7]), np.array([0.0, 0.0, 1.0]))
        out.append(Camera(pose, *SIZE, FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2))
    return out


def panorama_cameras(count: int) -> list[Camera]:
    """Cameras that show all around, on a circle about the middle of the room. The middle of their pictures is away from it."""
    width = 2 * SIZE[0]
    focal, lens = width / (2 * np.pi), MODELS["EQUIRECTANGULAR"].lens({})
    out = []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        eye = WALL / 2 + np.array([0.8 * np.cos(angle), 0.8 * np.sin(angle), 0.2 * np.sin(3 * angle)])
        back = -np.array([np.cos(angle + 0.5), np.sin(angle + 0.5), 0.0])
        pose = look_at(eye, back, np.array([0.0, 0.0, 1.0]))
        out.append(Camera(pose, width, width // 2, focal, focal, width / 2, width / 4, lens))
    return out


def photograph(camera: Camera, walls: int = 0) -> np.ndarray:
    """What the camera sees of a room between 0 and WALL: uint8 [H, W, 3]. walls: the first texture."""
    origins, directions = camera_rays(camera)
    with np.errstate(divide="ignore"):
        reach = (np.where(directions < 0, 0.0, WALL) - origins) / directions
    wall, far = reach.argmin(axis=-1), directions > 0
    points = origins + directions * reach.min(axis=-1)[..., None]
    out = np.zeros(points.shape, np.float32)
    for axis, opposite in product(range(3), (False, True)):
        seen = (wall == axis) & (far[..., axis] == opposite)
        u, v = (np.clip(points[seen][:, other] / WALL, 0, 0.998) * (TILE - 1) for other in range(3) if other != axis)
        out[seen] = bilinear(texture(walls + axis + 20 * opposite), u, v)
    return np.rint(out).astype(np.uint8)


def bilinear(values: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Values [N, C] of a picture between its pixels (u, v)."""
    return np.stack([map_coordinates(channel, (u, v), order=1) for channel in np.moveaxis(values, -1, 0)], axis=-1)
