"""A camera path that asks much of the adaptive resolution: far away, close by, through the middle, and out again."""

import numpy as np

from scenepack.pack import Pack
from viewer.features.film.camera_path import CameraPath, Keyframe
from viewer.rendering.camera import ViewCamera

# azimuth and elevation in degrees, distance from the middle in half sides of the grid, seconds to the next
STOPS = (
    (0, 25, 6.0, 1.5),
    (60, 20, 3.0, 1.0),
    (110, 15, 1.6, 1.0),
    (150, 10, 0.7, 1.0),
    (200, 35, 0.35, 0.8),
    (260, 20, 1.2, 1.2),
    (330, 40, 4.0, 1.5),
    (360, 25, 6.0, 1.0),
)


def flight(pack: Pack) -> CameraPath:
    """The path around and through `pack`; about eight seconds, with views of very different cost."""
    half = 0.5 * float(np.max(pack.max_xyz - pack.min_xyz))
    keys = []
    for azimuth, elevation, distance, seconds in STOPS:
        camera = ViewCamera.orbit(pack, azimuth, elevation, distance * half, 45.0)
        keys.append(Keyframe(camera.grid_T_camera, 45.0, seconds))
    return CameraPath(keys)
