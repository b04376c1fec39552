"""Gallery: the photographs that the open pack was made from, for the photographs page and the frusta."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from scenepack.pack import Pack
from viewer.app.photographs import Photographs
from viewer.app.thumbnails import Thumbnails

if TYPE_CHECKING:
    from viewer.app.application import App


@dataclass
class Gallery:
    """The state of the photographs page.

    photographs: of the open pack. chosen: index into their shots, of the one chosen last; it stays chosen when the camera
    moves away. reveal: the list has yet to scroll to it. split_shown: only shots of this split are listed; "" is all.
    frusta: they are drawn in the scene. frusta_size: over the usual one. frusta_opacity: 0 … 1, of the pictures in them.
    """

    photographs: Photographs | None = None
    chosen: int | None = None
    reveal: bool = False
    split_shown: str = ""
    thumbnails: Thumbnails | None = None
    frusta: bool = False
    frusta_size: float = 1.0
    frusta_opacity: float = 0.9

    def scene_changed(self, pack: Pack) -> None:
        """Takes over the photographs of another pack."""
        self.photographs = Photographs(pack)
        self.chosen, self.frusta, self.split_shown = None, False, ""

    def visible(self) -> list[int]:
        """The shots of the split that is shown."""
        shots = self.photographs.shots if self.photographs is not None else []
        return [index for index, shot in enumerate(shots) if self.split_shown in ("", shot.split)]

    def stand_in(self, app: App, index: int) -> None:
        """Moves the camera to a photograph's pose and compares with the photograph if it can be read."""
        if app.scene is None or self.photographs is None:
            return
        shot = self.photographs.shots[index]
        app.scene.rig.hold(shot.view, remember=True)
        if self.split_shown not in ("", shot.split):
            self.split_shown = ""
        self.chosen, self.reveal = index, True
        app.comparison.stop()
        app.touch()
        if self.photographs.has_picture(index):  # else its place is all there is to see
            app.comparison.with_photograph(self.photographs.pixels(index))

    def step(self, app: App, by: int) -> None:
        """Chooses the next listed photograph, or the previous one."""
        visible = self.visible()
        if not visible:
            return
        first = 0 if by > 0 else -1
        place = visible.index(self.chosen) + by if self.chosen in visible else first
        self.stand_in(app, visible[place % len(visible)])

    def tick(self, app: App) -> None:
        """Reads thumbnails while they are visible and redraws when they arrive."""
        thumbnails, photographs = self.thumbnails, self.photographs
        if thumbnails is not None:
            gone = app.scene is None or thumbnails.photographs is not photographs
            if gone or thumbnails.folder != thumbnails.photographs.folder:
                thumbnails.cancel()
                self.thumbnails = thumbnails = None
        if thumbnails is None:
            wanted = self.frusta or app.interface.shows("photographs")
            if wanted and app.scene is not None and photographs is not None and photographs.any_pictures:
                self.thumbnails = Thumbnails(photographs)
        elif thumbnails.news():
            app.touch(1)
