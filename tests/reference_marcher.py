"""The picture a pack must give, worked out slowly and plainly: NumPy in float64, every sample taken.

This is docs/rendering.md written down as code; the fast renderer is tested against it, and it shares nothing with it.
Notation: R rays; g = (p - min_xyz) / voxel_size is a grid position in voxels; bs = block_size; B = bs + 2.
Sample k of a ray is at t0 + 0.5 + k, where t0 is the distance in voxels at which the ray enters the grid's box. In a contracted
pack it is at 0.5 + k along the whole path, from where the ray begins.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from scenepack.constants import (
    ALPHA_CONTRIBUTES,
    NDC_NEAR,
    TRANSMITTANCE_SHADED,
    TRANSMITTANCE_STOP,
    UNPREMULTIPLY_GAIN,
    VIEW_FREQUENCIES,
)
from scenepack.contraction import path_of, piece_at
from scenepack.pack import Pack, ViewMlp
from training.scenes.lens import directions_at, shows
from viewer.rendering.camera import ViewCamera

PositionsAt = Callable[[np.ndarray, int], np.ndarray]
Corners = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class ReferencePicture:
    """What was marched, float64 [H, W, ...], nothing rounded.

    rgb: the picture, [H, W, 3]. diffuse: the same without the view-dependent residual. features [H, W, 4].
    alpha [H, W].
    """

    rgb: np.ndarray
    diffuse: np.ndarray
    features: np.ndarray
    alpha: np.ndarray


def render_reference(
    pack: Pack,
    camera: ViewCamera,
    *,
    background: tuple[float, float, float] = (1.0, 1.0, 1.0),
    crop: Corners | None = None,
) -> ReferencePicture:
    """The picture of `pack` from `camera`. crop: corners of a box in the grid frame that stands in for the grid's."""
    in_camera = pixel_directions(camera)
    assert not (camera.orthographic and pack.ndc), "a forward-facing pack has no orthographic view"
    near = np.maximum(camera.near / -in_camera[:, 2], camera.ray_near)  # along the ray
    near[~shows(*image_coordinates(camera), camera.distortion).ravel()] = np.inf
    training_T_camera = pack.worldspace_T_opengl @ camera.grid_T_camera
    viewdirs = in_camera @ training_T_camera[:3, :3].T
    viewdirs /= np.linalg.norm(viewdirs, axis=1, keepdims=True)
    if pack.ndc:
        origins, directions, first = ndc_rays(pack, training_T_camera[:3, 3], viewdirs, near)
    else:
        directions = in_camera @ camera.grid_T_camera[:3, :3].T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = (pixel_origins(camera) - pack.min_xyz) / pack.voxel_size
        first = near / pack.voxel_size
    rgb, features, transmittance = march(pack, origins, directions, first, crop)
    diffuse, shaded, features, transmittance = shade(pack, rgb, features, transmittance, viewdirs, background)
    size = (camera.height, camera.width)
    return ReferencePicture(
        np.clip(shaded, 0, 1).reshape(*size, 3),
        np.clip(diffuse, 0, 1).reshape(*size, 3),
        features.reshape(*size, 4),
        (1.0 - transmittance).reshape(size),
    )


def shade(
    pack: Pack, rgb: np.ndarray, features: np.ndarray, transmittance: np.ndarray, viewdirs: np.ndarray, background
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Of what R rays accumulated: the colour [R, 3] before and with the view MLP, features [R, 4] and transmittance [R]."""
    if pack.ndc:
        alpha = 1.0 - transmittance
        gain = np.minimum(1.0, UNPREMULTIPLY_GAIN * alpha) / np.where(alpha > 0, alpha, 1.0)
        rgb, features, transmittance = rgb * gain[:, None], features * gain[:, None], 1.0 - alpha * gain
    diffuse = rgb + transmittance[:, None] * np.asarray(background)
    shaded = diffuse.copy()
    if pack.view_mlp is not None:
        hit = transmittance <= TRANSMITTANCE_SHADED
        shaded[hit] += view_residual(pack.view_mlp, viewdirs[hit], diffuse[hit], features[hit])
    return diffuse, shaded, features, transmittance


def image_coordinates(camera: ViewCamera) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) of pixel centres, [H, W] each."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    return (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy


def pixel_directions(camera: ViewCamera) -> np.ndarray:
    """Unit directions [H W, 3] in camera axes (x right, y up, z back), through pixel centres, row by row from the top."""
    if camera.orthographic:
        return np.tile([0.0, 0.0, -1.0], (camera.height * camera.width, 1))
    directions = directions_at(*image_coordinates(camera), camera.distortion).reshape(-1, 3)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def pixel_origins(camera: ViewCamera) -> np.ndarray:
    """Where the rays of the same pixels begin, [H W, 3], grid frame: the camera, or the plane across an orthographic one."""
    if not camera.orthographic:
        return np.broadcast_to(camera.position, (camera.height * camera.width, 3))
    u, v = image_coordinates(camera)
    across = np.stack([u, -v, np.zeros_like(u)], axis=-1)
    return camera.position + across.reshape(-1, 3) @ camera.grid_T_camera[:3, :3].T


def ndc_rays(
    pack: Pack, camera: np.ndarray, directions: np.ndarray, near: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """NeRF's NDC warp (its appendix C) of training-frame rays, then into voxels.

    camera [3], directions [R, 3]. Returns origins and unit directions [R, 3] in voxels, and the distance [R] in voxels
    to begin at: at the warp's near plane, but not before `near` along the unwarped ray; infinite for rays that turn away.
    """
    width, height, focal = pack.input_width, pack.input_height, pack.input_focal
    assert width is not None and height is not None and focal is not None, "an NDC pack without input_* keys"
    ahead = directions[:, 2] < -1e-8
    d = np.where(ahead[:, None], directions, [0.0, 0.0, -1.0])
    to_plane = -(NDC_NEAR + camera[2]) / d[:, 2]

    def warp(points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        ndc = np.stack([-focal / (width / 2) * x / z, -focal / (height / 2) * y / z, 1.0 + 2.0 * NDC_NEAR / z], axis=1)
        grid = (ndc - pack.worldspace_T_opengl[:3, 3]) @ np.linalg.inv(pack.worldspace_T_opengl[:3, :3]).T
        return (grid - pack.min_xyz) / pack.voxel_size

    start = camera + to_plane[:, None] * d
    origins = warp(start)
    towards = warp(start + d) - origins  # lines stay lines under the warp
    unit = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    begin = warp(camera + np.maximum(near, to_plane)[:, None] * d)
    first = np.sum((begin - origins) * unit, axis=1)
    return origins, unit, np.where(ahead, first, np.inf)


def march(
    pack: Pack, origins: np.ndarray, directions: np.ndarray, first: np.ndarray, crop: Corners | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Composites every sample of rays given in voxels: origins and unit directions [R, 3].

    first [R]: where a ray may begin, voxels. Returns rgb [R, 3], features [R, 4], transmittance [R].
    """
    low, high = np.zeros(3), np.asarray(pack.grid_size, np.float64)
    if crop is not None:
        corners = (np.asarray(crop) - pack.min_xyz) / pack.voxel_size
        low, high = np.maximum(low, corners.min(axis=0)), np.minimum(high, corners.max(axis=0))
    trace = straight_samples if pack.contraction is None else contracted_samples
    positions_at, counts = trace(pack, origins, directions, first, (low, high))

    count = len(origins)
    rgb, features, transmittance = np.zeros((count, 3)), np.zeros((count, 4)), np.ones(count)
    k = 0
    alive = np.flatnonzero(counts > 0)
    while len(alive):
        positions = positions_at(alive, k)
        rgba, fetched = fetch(pack, positions)
        inside = np.all((positions >= low - 1e-9) & (positions <= high + 1e-9), axis=1)
        contributes = (rgba[:, 3] > ALPHA_CONTRIBUTES) & inside
        rays = alive[contributes]
        rgb[rays] += transmittance[rays, None] * rgba[contributes, :3]
        features[rays] += transmittance[rays, None] * fetched[contributes]
        transmittance[rays] *= 1.0 - rgba[contributes, 3]
        k += 1
        alive = alive[(k < counts[alive]) & (transmittance[alive] > TRANSMITTANCE_STOP)]
    return rgb, features, transmittance


def straight_samples(
    _: Pack, origins: np.ndarray, directions: np.ndarray, first: np.ndarray, box: tuple[np.ndarray, np.ndarray]
) -> tuple[PositionsAt, np.ndarray]:
    """Where sample k of rays lies (their numbers [N] and k to [N, 3]), and up to which k [R] samples lie in the box."""
    low, high = box
    with np.errstate(divide="ignore", invalid="ignore"):
        to_low, to_high = (low - origins) / directions, (high - origins) / directions
    # A ray parallel to a pair of faces is between them for ever, or never.
    between = (origins >= low) & (origins <= high)
    parallel = directions == 0
    enter = np.where(parallel, np.where(between, -np.inf, np.inf), np.minimum(to_low, to_high)).max(axis=1)
    leave = np.where(parallel, np.inf, np.maximum(to_low, to_high)).min(axis=1)
    start = np.maximum(enter, first) + 0.5
    return lambda rays, k: origins[rays] + (start[rays] + k)[:, None] * directions[rays], leave - start


def contracted_samples(
    pack: Pack, origins: np.ndarray, directions: np.ndarray, first: np.ndarray, _: tuple[np.ndarray, np.ndarray]
) -> tuple[PositionsAt, np.ndarray]:
    """Likewise; up to which k samples lie before infinity."""
    assert pack.contraction is not None
    radius, centre = pack.contraction / pack.voxel_size, -pack.min_xyz / pack.voxel_size
    path = path_of((origins - centre) / radius, directions, first / radius)

    def positions_at(rays: np.ndarray, k: int) -> np.ndarray:
        s = np.full(len(origins), (0.5 + k) / radius)
        piece = piece_at(path, s)
        row = np.arange(len(origins))
        contracted = path.origins[row, piece] + s[:, None] * path.directions[row, piece]
        return (centre + radius * contracted)[rays]

    return positions_at, radius * path.ends - 0.5


def fetch(pack: Pack, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Trilinear rgba and features [R, 4] at positions [R, 3] in voxels, within each macroblock's padded copy."""
    count = len(positions)
    rgba, features = np.zeros((count, 4)), np.zeros((count, 4))
    blocks = np.clip(np.floor(positions / pack.block_size).astype(int), 0, np.array(pack.grid_blocks) - 1)
    x, y, z = blocks.T
    held = pack.occupied[z, y, x]
    slots = pack.atlas_indices[z, y, x][held].astype(int)
    local = positions[held] - blocks[held] * pack.block_size
    # Voxel i of the copy has its centre at local i - 0.5, for the copy begins one voxel before the data.
    index = np.floor(local + 0.5).astype(int)
    weight = local + 0.5 - index
    base = slots * pack.padded_block_size + index
    for corner in np.ndindex(2, 2, 2):  # (z, y, x)
        offset = np.array(corner[::-1])
        share = np.prod(np.where(offset, weight, 1.0 - weight), axis=1)[:, None] / 255.0
        cx, cy, cz = (base + offset).T
        # Rounding may put a sample that is leaving the macroblock a hair outside of it; its share there is nothing.
        at = tuple(np.clip(c, 0, n - 1) for c, n in zip((cz, cy, cx), pack.atlas_rgba.shape[:3], strict=True))
        rgba[held] += share * pack.atlas_rgba[at]
        if pack.atlas_features is not None:
            features[held] += share * pack.atlas_features[at]
    return rgba, features


def view_encoding(viewdirs: np.ndarray) -> np.ndarray:
    """[R, 27]: v, sin(2^i v) for i = 0 .. 3, and the same with pi / 2 added inside the sine; frequency-major."""
    scaled = np.concatenate([2.0**i * viewdirs for i in range(VIEW_FREQUENCIES)], axis=1)
    return np.concatenate([viewdirs, np.sin(scaled), np.sin(scaled + 0.5 * np.pi)], axis=1)


def view_residual(mlp: ViewMlp, viewdirs: np.ndarray, rgb: np.ndarray, features: np.ndarray) -> np.ndarray:
    """The view MLP's colour [R, 3] for viewdirs [R, 3] (unit, training frame), rgb [R, 3] and features [R, 4]."""
    hidden = np.concatenate([view_encoding(viewdirs), rgb, features], axis=1)
    for weights, bias in zip(mlp.weights[:2], mlp.biases[:2], strict=True):
        hidden = np.maximum(hidden @ weights.astype(np.float64) + bias, 0.0)
    return 1.0 / (1.0 + np.exp(-(hidden @ mlp.weights[2].astype(np.float64) + mlp.biases[2])))
