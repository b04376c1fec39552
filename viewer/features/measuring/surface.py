"""Where a ray meets the scene: read from the pack itself, without the GPU, for one pixel at a time.

Notation: u, distance along a ray in voxels (of the warped space in forward-facing packs, along its path in contracted ones);
alpha(u), the opacity per voxel that the renderer interpolates there; T, what is left of the light. The renderer's depth is the
mean over all that a ray meets, which lies half a voxel behind a hard face. Where T has lost half of what the ray loses in all,
the ray is in what is seen; the surface is where alpha first reaches half of the highest that it has in there. On a hard face,
that is the face itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import ndimage

from scenepack.constants import ALPHA_CONTRIBUTES, EMPTY_BLOCK, NDC_NEAR
from scenepack.contraction import path_of, piece_at
from scenepack.exports.field import ExportFrame, ndc_camera
from scenepack.pack import Pack
from training.scenes.lens import image_of
from training.scenes.scene import ndc_rays
from viewer.rendering.camera import ViewCamera, ray_through
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.settings import RenderSettings

if TYPE_CHECKING:
    from viewer.app.application import App

Box = tuple[np.ndarray, np.ndarray]  # its corners, voxels
STEPS = 4  # per voxel
LEAST_SEEN = 0.1  # of a ray's light that a surface takes
BEYOND = 8 * STEPS  # how far behind the middle the highest opacity is looked for: rays that graze a face find it soft


@dataclass(frozen=True)
class Hit:
    point: np.ndarray  # float64 [3], grid frame (in forward-facing packs: before the warp)
    distance: float  # from the camera, grid units (from the plane of the picture, where rays are parallel)
    position: np.ndarray  # float64 [3], voxels


class _Ray(NamedTuple):
    places: Callable[[np.ndarray], np.ndarray]  # from u, float64 [n], to voxels, float64 [n, 3]
    first: float  # u where it begins
    last: float  # u where it ends


def surface_at(pack: Pack, camera: ViewCamera, settings: RenderSettings, x: float, y: float) -> Hit | None:
    """What is seen at a point of the picture (pixels from its corner) with its crop box and near plane; None for nothing."""
    frame = RayFrame(pack)
    origin, direction = ray_through(camera, x, y)
    ahead = float(direction @ -camera.grid_T_camera[:3, 2])
    if not image_of(direction @ camera.grid_T_camera[:3, :3], camera.distortion)[2]:
        return None
    near = max(max(camera.near, settings.near) / max(ahead, 1e-8), camera.ray_near)
    box = frame.box(settings)
    if pack.ndc:
        ray = _warped(frame, origin, direction, near, box)
    elif pack.contraction is not None:
        ray = _contracted(pack, pack.contraction, origin, direction, near)
    else:
        voxel = pack.voxel_size
        ray = _line((origin - pack.min_xyz) / voxel, direction, near / voxel, math.inf, box)
    u = None if ray is None else _met(pack, ray, *box)
    if ray is None or u is None:
        return None
    position = ray.places(np.array([u]))
    distance = float((ExportFrame(pack).points(position)[0] - origin) @ direction)
    return Hit(origin + distance * direction, distance, position[0])


def surface_under(app: App, x: float, y: float) -> Hit | None:
    """What is seen at a point of the viewport (window units from its corner); None for nothing, or where no scene is open."""
    camera, scale = app.viewport.camera, app.viewport.pixels_per_unit
    if app.scene is None or camera is None:
        return None
    return surface_at(app.scene.pack, camera, app.settings, x * scale, y * scale)


def depth_in_middle(pack: Pack, camera: ViewCamera, settings: RenderSettings) -> float | None:
    """How far along the optical axis what is seen in the middle of the picture lies, grid units; None for nothing."""
    hit = surface_at(pack, camera, settings, 0.5 * camera.width, 0.5 * camera.height)
    return None if hit is None else depth_of(camera, hit.point)


def depth_of(camera: ViewCamera, point: np.ndarray) -> float:
    """How far along the optical axis a point (float [3], grid frame) lies, grid units; below 0 behind the camera."""
    return float((camera.position - point) @ camera.grid_T_camera[:3, 2])


def _line(origin: np.ndarray, direction: np.ndarray, first: float, last: float, box: Box) -> _Ray:
    """A straight line through the voxels, also warped ones, from `first` to `last` as far as it lies in the box."""
    way = np.where(np.abs(direction) < 1e-8, 1e-8, direction)
    a, b = (box[0] - origin) / way, (box[1] - origin) / way
    first, last = max(float(np.minimum(a, b).max()), first), min(float(np.maximum(a, b).min()), last)
    return _Ray(lambda u: origin + u[:, None] * direction, first, last)


def _contracted(pack: Pack, half_side: float, origin: np.ndarray, direction: np.ndarray, near: float) -> _Ray:
    """Of a contracted pack, where u begins at 0. half_side: of the inner cube, grid units."""
    path = path_of(origin[None] / half_side, direction[None], np.array([near / half_side]))
    radius, centre = half_side / pack.voxel_size, -pack.min_xyz / pack.voxel_size

    def places(u: np.ndarray) -> np.ndarray:
        s = u / radius
        piece = piece_at(path, s[None])[0]
        return centre + radius * (path.origins[0, piece] + s[:, None] * path.directions[0, piece])

    return _Ray(places, 0.0, radius * float(path.ends[0]) * (1.0 - 1e-6))


def _warped(frame: RayFrame, origin: np.ndarray, direction: np.ndarray, near: float, box: Box) -> _Ray | None:
    """As ndc_ray of shaders/ray.glsl; None where the ray runs away from the scene."""
    ahead = frame.training_T_grid[:3, :3] @ direction
    eye = frame.training_T_grid[:3, :3] @ origin + frame.training_T_grid[:3, 3]
    if ahead[2] > -1e-8:
        return None
    start, way = ndc_rays(eye, ahead, *ndc_camera(frame.pack))
    voxel_R_ndc = frame.ndc["voxel_R_ndc"]
    start, way = voxel_R_ndc @ start + frame.ndc["voxel_t_ndc"], voxel_R_ndc @ way
    length = float(np.linalg.norm(way))
    # z of where the ray begins, from the NDC near plane on
    beyond = min(float(eye[2] + near * ahead[2]) + NDC_NEAR, 0.0)
    return _line(start, way / length, length * beyond / (beyond - NDC_NEAR), length * (1.0 - 1e-6), box)


def _met(pack: Pack, ray: _Ray, low: np.ndarray, high: np.ndarray) -> float | None:
    """u where the ray meets a surface within a box (voxels)."""
    if ray.last <= ray.first:
        return None
    u = ray.first + np.arange(int((ray.last - ray.first) * STEPS) + 1) / STEPS
    places = ray.places(u)
    inside = np.all((places > low - 1e-6) & (places < high + 1e-6), axis=1)
    alpha = opacities(pack, places)
    alpha = np.where(inside & (alpha > ALPHA_CONTRIBUTES), alpha, 0.0)
    left = np.cumprod((1.0 - np.minimum(alpha, 1.0 - 1e-9)) ** (1.0 / STEPS))
    taken = 1.0 - left
    if taken[-1] < LEAST_SEEN:
        return None
    middle = int(np.searchsorted(taken, 0.5 * taken[-1]))
    empty = np.flatnonzero(alpha == 0.0)
    before, behind = empty[empty < middle], empty[empty > middle]
    begin = int(before[-1]) if len(before) else 0
    end = min(int(behind[0]) if len(behind) else len(alpha), middle + BEYOND)
    half = 0.5 * float(alpha[begin:end].max())
    at = begin + int(np.argmax(alpha[begin:end] >= half))
    if at == begin or alpha[at] <= alpha[at - 1]:
        return float(u[at])
    share = (half - alpha[at - 1]) / (alpha[at] - alpha[at - 1])
    return float(u[at - 1] + np.clip(share, 0.0, 1.0) / STEPS)


def opacities(pack: Pack, places: np.ndarray) -> np.ndarray:
    """The opacity that the renderer interpolates at places (float [n, 3], voxels), float64 [n] in 0 … 1; 0 outside."""
    found = np.zeros(len(places))
    inside = ((places >= 0) & (places < np.asarray(pack.grid_size))).all(axis=1)
    blocks = np.zeros((len(places), 3), int)
    blocks[inside] = np.floor(places[inside]).astype(int) // pack.block_size
    slots = pack.atlas_indices[blocks[:, 2], blocks[:, 1], blocks[:, 0]].astype(int)
    held = np.flatnonzero(inside & (slots[:, 0] != EMPTY_BLOCK))
    if not len(held):
        return found
    local = places[held] - blocks[held] * pack.block_size + 0.5  # voxel centres of the padded copy are at whole numbers
    x, y, z = (local + slots[held] * pack.padded_block_size).T
    found[held] = ndimage.map_coordinates(pack.atlas_rgba[..., 3], (z, y, x), np.float64, order=1) / 255.0
    return found
