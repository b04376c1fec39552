"""Open packs that are not shown now. Each keeps its camera, crop and camera path; switching to it reads nothing.

They stay in main memory; only the pack that is shown is on the GPU.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenepack.pack import Pack
from viewer.app.annotations import Annotations
from viewer.app.path import CameraPath
from viewer.app.state import OpenScene

if TYPE_CHECKING:
    from viewer.app.application import App

MOST_BYTES = 2 << 30  # of all that are not shown
MOST_PACKS = 7
Corners = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class OpenPack:
    """An open pack that is not shown. crop, near: as in RenderSettings. path: its film's.

    annotations: of when it was left; None: as saved.
    """

    scene: OpenScene
    crop: Corners | None
    near: float
    path: CameraPath
    annotations: Annotations | None = None


@dataclass
class OpenPacks:
    """The open packs that are not shown."""

    packs: list[OpenPack] = field(default_factory=list)  # in Ctrl+Tab's order
    show_list: bool = False  # opens the pack menu in the next frame

    def add(self, entry: OpenPack, *, first: bool = False) -> list[str]:
        """Adds a pack and closes others if there are too many. Returns the names of those that were closed.

        first: at the head of the order, not at its end.
        """
        self.drop(entry.scene.path)
        self.packs.insert(0 if first else len(self.packs), entry)
        gone = []
        while len(self.packs) > MOST_PACKS or (sum(map(_bytes, self.packs)) > MOST_BYTES and self.packs):
            oldest = self.packs.pop(-1 if first else 0)
            gone.append(oldest.scene.name)
        return gone

    def keep(self, app: App, entry: OpenPack, *, first: bool = False) -> None:
        """Adds a pack and logs which others were closed for it."""
        for name in self.add(entry, first=first):
            app.messages.log(f"{name} is closed, for there is no room for more open packs")

    def switch(self, app: App, step: int) -> None:
        """Shows the next open pack (step 1), or the one before (-1)."""
        if self.packs:
            self.switch_to(app, self.packs[0 if step > 0 else -1], backwards=step < 0)
        else:
            app.messages.say("No other pack is open")

    def switch_to(self, app: App, entry: OpenPack, *, backwards: bool = False) -> None:
        """Shows an open pack. backwards: the pack shown before becomes the first in the order, not the last."""
        if app.filming.export is not None:
            app.messages.say("An export is running: wait for it, or cancel it", "warning")
            return
        app.opening.cancel(app)
        if entry not in self.packs:  # what was still being read is closed, and this one has come back
            return
        left = app.left_now()
        app.turn_to(entry)
        self.packs.remove(entry)
        if left is not None:
            self.keep(app, left, first=backwards)

    def drop(self, path: Path) -> None:
        """Removes the pack of `path`, if there is one, because it is opened again."""
        self.packs = [entry for entry in self.packs if entry.scene.path.resolve() != path.resolve()]


def _bytes(entry: OpenPack) -> int:
    return bytes_of(entry.scene.pack)


def bytes_of(pack: Pack) -> int:
    """Size of a pack in main memory."""
    features = pack.atlas_features
    return pack.atlas_rgba.nbytes + pack.atlas_indices.nbytes + (features.nbytes if features is not None else 0)
