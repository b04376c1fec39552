"""View pictures: thumbnails of bookmarks and keyframes, drawn one at a time while nothing moves."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from viewer.app.canvas_interface import CanvasInterface
from viewer.app.pose import view_camera
from viewer.rendering.settings import RenderSettings

if TYPE_CHECKING:
    from viewer.app.application import App

SIZE = (144, 90)  # width, height, pixels
MOST_KEPT = 200  # 38 KiB each, and as much on the card
Key = tuple[bytes, float]


@dataclass
class ViewPictures:
    """pictures: uint8 [90, 144, 3] by view, least recently used first."""

    _pictures: OrderedDict[Key, np.ndarray] = field(default_factory=OrderedDict)
    _drawn_with: tuple[object, ...] = ()
    _drew: bool = False  # in this frame

    def clear(self, canvas: CanvasInterface | None) -> None:
        """Forgets the pictures, because another pack is shown."""
        for key in self._pictures:
            if canvas is not None:
                canvas.drop_image(_name(key))
        self._pictures.clear()

    def tick(self, app: App) -> None:
        """A new frame. Another background, or a finer pack, is another picture."""
        self._drew = False
        pack = app.scene.pack if app.scene is not None else None
        now = (id(pack), app.settings.background)
        if now != self._drawn_with:
            self._drawn_with = now
            self.clear(app.canvas)

    def texture(self, app: App, canvas: CanvasInterface, grid_T_camera: np.ndarray, fov: float) -> int | None:
        """OpenGL name of the picture of a view (float64 [4, 4]; vertical degrees); None while it is not drawn yet.

        One is drawn in a frame at most, and none while the picture is not whole: that goes before.
        """
        if app.scene is None:
            return None
        key = (np.round(grid_T_camera, 6).tobytes(), round(fov, 4))
        if key not in self._pictures:
            if self._drew or canvas.pending or not app.scene.whole:
                app.touch(1)
                return None
            self._drew = True
            camera = view_camera(grid_T_camera, fov, SIZE)
            self._pictures[key] = canvas.snapshot(camera, RenderSettings(background=app.settings.background))
            if len(self._pictures) > MOST_KEPT:
                canvas.drop_image(_name(self._pictures.popitem(last=False)[0]))
            app.touch(2)
        self._pictures.move_to_end(key)
        return canvas.image(_name(key), self._pictures[key])


def _name(key: Key) -> str:
    return f"view {key[0].hex()} {key[1]}"
