"""What pictures are made of, as numbers: colour with opacity, depth, normals (docs/rendering.md, "Layers in files").

A raw picture, float32 [h, w, 4], is what the renderer draws with RenderSettings.raw: in 0 ... 2 something times opacity, in 3 the
opacity A, so that a mean over rays stays a mean over light (viewer.rendering.supersampling). Modes:
  depth         A * p: the point at the ray's mean depth, in voxels; in forward-facing packs in the training frame, unwarped
  normals       A * n: the unit vector that the surface faces along, grid frame
  samples, jumps  no colour, but what the ray cost: samples fetched, steps over empty space, opacity
  all others    the colour times A, nothing of the background in it: premultiplied
"""

import numpy as np

from scenepack.constants import TRANSMITTANCE_STOP
from scenepack.pack import Pack
from scenepack.placement import transformed
from viewer.rendering.camera import ViewCamera

SEEN = 1.0 / 255.0  # least opacity at which there is a depth or a normal to speak of
FULL = 1.0 - TRANSMITTANCE_STOP  # the opacity at which a ray ends


def depth_along_axis(raw: np.ndarray, camera: ViewCamera, pack: Pack) -> np.ndarray:
    """Mean depth, float32 [h, w], of a raw picture of mode depth: along the optical axis (z-depth), grid units; 0 for nothing.

    Of a panorama, which has no one axis, the distance from the camera.
    """
    alpha = raw[..., 3:].astype(np.float64)
    points = raw[..., :3] / np.maximum(alpha, SEEN)
    frame_T_camera = camera.grid_T_camera
    if pack.ndc:
        frame_T_camera = pack.worldspace_T_opengl @ camera.grid_T_camera
    else:
        points = pack.min_xyz + pack.voxel_size * points
    local = transformed(np.linalg.inv(frame_T_camera), points)
    depth = np.linalg.norm(local, axis=-1) if camera.is_panorama else -local[..., 2]
    return np.where(raw[..., 3] >= SEEN, depth, 0.0).astype(np.float32)


def unit_normals(raw: np.ndarray) -> np.ndarray:
    """Normals, float32 [h, w, 3], of a raw picture of mode normals: unit length, grid frame; 0 for nothing."""
    length = np.linalg.norm(raw[..., :3], axis=-1, keepdims=True)
    some = (raw[..., 3:] >= SEEN) & (length > 1e-6)
    return np.where(some, raw[..., :3] / np.maximum(length, 1e-6), 0.0).astype(np.float32)


def straight_rgba(raw: np.ndarray) -> np.ndarray:
    """uint8 [h, w, 4] as PNG has it: colour not multiplied by opacity.

    Over the background with which the raw picture was drawn, it gives the picture, but for rounding. A ray ends at
    opacity 254/255, which counts as opaque.
    """
    alpha = np.where(raw[..., 3:] >= FULL, 1.0, raw[..., 3:])
    colour = np.where(alpha >= 0.5 / 255.0, raw[..., :3] / np.maximum(alpha, 1e-6), 0.0)
    return np.rint(255.0 * np.clip(np.concatenate([colour, alpha], axis=-1), 0.0, 1.0)).astype(np.uint8)


def linear_rgb(raw: np.ndarray) -> np.ndarray:
    """Light, float32 [h, w, 3], of a raw colour picture: sRGB decoded (IEC 61966-2-1), still times opacity."""
    alpha = raw[..., 3:]
    colour = np.clip(np.where(alpha > 0, raw[..., :3] / np.maximum(alpha, 1e-6), 0.0), 0.0, 1.0)
    light = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return (light * alpha).astype(np.float32)
