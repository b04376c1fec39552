"""The crop box: faces that can be dragged, moving, scaling, and undoing all that.

Corners are in the grid frame; no box means that nothing is cut off.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from scenepack.pack import Pack
from viewer.app.pose import triple
from viewer.app.projection import along_axis
from viewer.rendering.camera import ViewCamera, content_box

if TYPE_CHECKING:
    from viewer.app.application import App
    from viewer.app.rig import CameraRig

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
FACES = tuple((axis, side) for axis in range(3) for side in range(2))  # side 0: the low face
Tool = Literal["faces", "move", "scale"]
TOOLS: tuple[Tool, ...] = get_args(Tool)
UNDO_DEPTH = 100
THINNEST = 0.01  # of the content's extent along an axis


def whole(pack: Pack) -> Box:
    """The box around all of the content."""
    low, high = content_box(pack)
    return triple(low), triple(high)


def face_centre(box: Box, face: int) -> np.ndarray:
    """float64 [3]: the middle of a face."""
    axis, side = FACES[face]
    centre = 0.5 * (np.asarray(box[0]) + np.asarray(box[1]))
    centre[axis] = box[side][axis]
    return centre


def with_face(pack: Pack, box: Box, face: int, value: float) -> Box:
    """The box with a face moved to `value` along its axis, kept within the content and off the opposite face."""
    axis, side = FACES[face]
    outer = whole(pack)
    gap = THINNEST * (outer[1][axis] - outer[0][axis])
    corners = [list(box[0]), list(box[1])]
    if side == 0:
        corners[0][axis] = min(max(value, outer[0][axis]), corners[1][axis] - gap)
    else:
        corners[1][axis] = max(min(value, outer[1][axis]), corners[0][axis] + gap)
    return triple(np.array(corners[0])), triple(np.array(corners[1]))


def dragged(pack: Pack, box: Box, face: int, camera: ViewCamera, moved: tuple[float, float]) -> Box:
    """The box after a face's handle was dragged by `moved` pixels."""
    axis, side = FACES[face]
    step = along_axis(camera, face_centre(box, face), axis, moved)
    return with_face(pack, box, face, box[side][axis] + step)


def placed(pack: Pack, centre: np.ndarray, size: np.ndarray) -> Box:
    """The box of that centre and size (float [3] each), its centre kept within the content and none of it too thin."""
    low, high = (np.asarray(corner) for corner in whole(pack))
    centre = np.clip(centre, low, high)
    half = 0.5 * np.clip(np.abs(size), THINNEST * (high - low), 2.0 * (high - low))
    return triple(centre - half), triple(centre + half)


@dataclass
class CropEdits:
    """Edits of the crop box, to be undone in turn with the camera's moves. tool: what the mouse does to the box.

    An entry is the box before and how many moves of the camera could be undone then: that tells which came last.
    """

    tool: Tool = "faces"
    _undo: list[tuple[Box | None, int]] = field(default_factory=list)
    _redo: list[tuple[Box | None, int]] = field(default_factory=list)
    _rig: CameraRig | None = None
    _gestures: int = 0  # of the camera, up to now

    def remember(self, app: App) -> None:
        """Marks the present box as one to come back to; call before each edit."""
        rig = self._current(app)
        if rig is not None and (not self._undo or self._undo[-1][0] != app.settings.crop):
            self._undo = [*self._undo[1 - UNDO_DEPTH :], (app.settings.crop, rig.undo_depth)]
            rig.forget_redo()
            self._redo = []

    def undo(self, app: App) -> bool:
        """Takes back the last edit or the camera's last move, whichever came later; False where there is none."""
        rig = self._current(app)
        if rig is None:
            return False
        if self._undo and self._undo[-1][1] >= rig.undo_depth:
            box, _ = self._undo.pop()
            self._redo.append((app.settings.crop, rig.redo_depth))
            app.set(crop=box)
            return True
        return rig.undo()

    def redo(self, app: App) -> bool:
        """Does again what was taken back last; False where there is nothing."""
        rig = self._current(app)
        if rig is None:
            return False
        if self._redo and self._redo[-1][1] >= rig.redo_depth:
            box, _ = self._redo.pop()
            self._undo.append((app.settings.crop, rig.undo_depth))
            app.set(crop=box)
            return True
        return rig.redo()

    def _current(self, app: App) -> CameraRig | None:
        """The scene's rig; what belongs to another is forgotten, and what cannot be redone after a new move, too."""
        rig = app.scene.rig if app.scene is not None else None
        if rig is not self._rig:
            self._rig, self._undo, self._redo = rig, [], []
        if rig is not None and rig.gestures != self._gestures:
            self._redo, self._gestures = [], rig.gestures
        return rig
