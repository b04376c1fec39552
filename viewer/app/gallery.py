"""The photographs that the open pack was made from: which are listed, which one is chosen, and how they stand in the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from scenepack.pack import Pack
from viewer.app.comparison import Comparison
from viewer.app.host import Host
from viewer.app.photographs import Photographs
from viewer.app.state import Interface
from viewer.app.thumbnails import Thumbnails


class GalleryHost(Host, Protocol):
    """What standing in a photograph is about: the picture is compared with it."""

    comparison: Comparison
    interface: Interface


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
        """Another pack is shown: its photographs are others."""
        self.photographs = Photographs(pack)
        self.chosen, self.frusta, self.split_shown = None, False, ""

    def visible(self) -> list[int]:
        """The shots of the split that is shown."""
        shots = self.photographs.shots if self.photographs is not None else []
        return [index for index, shot in enumerate(shots) if self.split_shown in ("", shot.split)]

    def stand_in(self, host: GalleryHost, index: int) -> None:
        """Puts the camera where a photograph was taken, and the photograph beside the picture if it can be read."""
        if host.scene is None or self.photographs is None:
            return
        shot = self.photographs.shots[index]
        host.scene.rig.hold(shot.view, remember=True)
        if self.split_shown not in ("", shot.split):
            self.split_shown = ""
        self.chosen, self.reveal = index, True
        host.comparison.stop()
        host.touch()
        if self.photographs.has_picture(index):  # else its place is all there is to see
            host.comparison.with_photograph(self.photographs.pixels(index))

    def step(self, host: GalleryHost, by: int) -> None:
        """Stands in the next photograph of those that are shown, or in the one before."""
        visible = self.visible()
        if not visible:
            return
        first = 0 if by > 0 else -1
        place = visible.index(self.chosen) + by if self.chosen in visible else first
        self.stand_in(host, visible[place % len(visible)])

    def tick(self, host: GalleryHost) -> None:
        """Time passes: thumbnails are read while they are wanted, and drawn as they arrive."""
        thumbnails, photographs = self.thumbnails, self.photographs
        if thumbnails is not None:
            gone = host.scene is None or thumbnails.photographs is not photographs
            if gone or thumbnails.folder != thumbnails.photographs.folder:
                thumbnails.cancel()
                self.thumbnails = thumbnails = None
        if thumbnails is None:
            wanted = self.frusta or host.interface.shows("photographs")
            if wanted and host.scene is not None and photographs is not None and photographs.any_pictures:
                self.thumbnails = Thumbnails(photographs)
        elif thumbnails.news():
            host.touch(1)
