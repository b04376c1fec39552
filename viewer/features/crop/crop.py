"""The crop box: faces that can be dragged, moving and scaling.

Corners are in the grid frame; no box means that nothing is cut off.
"""

from typing import Literal

import numpy as np

from scenepack.exports.field import Corners
from scenepack.pack import Pack
from viewer.core.pose import along_axis, triple
from viewer.rendering.camera import ViewCamera, content_box

FACES = tuple((axis, side) for axis in range(3) for side in range(2))  # side 0: the low face
Tool = Literal["faces", "move", "scale"]

THINNEST = 0.01  # of the content's extent along an axis


def whole(pack: Pack) -> Corners:
    """The box around all of the content."""
    low, high = content_box(pack)
    return triple(low), triple(high)


def face_centre(box: Corners, face: int) -> np.ndarray:
    """float64 [3]: the middle of a face."""
    axis, side = FACES[face]
    centre = 0.5 * np.sum(box, axis=0)
    centre[axis] = box[side][axis]
    return centre


def with_face(pack: Pack, box: Corners, face: int, value: float) -> Corners:
    """The box with a face moved to `value` along its axis, kept within the content and off the opposite face."""
    axis, side = FACES[face]
    outer = whole(pack)
    gap, corners = THINNEST * (outer[1][axis] - outer[0][axis]), np.array(box)
    if side == 0:
        corners[0, axis] = min(max(value, outer[0][axis]), corners[1, axis] - gap)
    else:
        corners[1, axis] = max(min(value, outer[1][axis]), corners[0, axis] + gap)
    return triple(corners[0]), triple(corners[1])


def dragged(pack: Pack, box: Corners, face: int, camera: ViewCamera, moved: tuple[float, float]) -> Corners:
    """The box after a face's handle was dragged by `moved` pixels."""
    axis, side = FACES[face]
    step = along_axis(camera, face_centre(box, face), axis, moved)
    return with_face(pack, box, face, box[side][axis] + step)


def placed(pack: Pack, centre: np.ndarray, size: np.ndarray) -> Corners:
    """The box of that centre and size (float [3] each), its centre kept within the content and none of it too thin."""
    low, high = np.array(whole(pack))
    centre = np.clip(centre, low, high)
    half = 0.5 * np.clip(np.abs(size), THINNEST * (high - low), 2.0 * (high - low))
    return triple(centre - half), triple(centre + half)
