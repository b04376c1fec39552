"""Packs that are open besides the one that is shown: each keeps its camera, its cuts and its path, and comes back at once.

They stay in the computer's memory; only the one that is shown is on the graphics card.
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
class Shelved:
    """An open pack that is not shown. crop, near: as in RenderSettings. path: its film's.

    annotations: of when it was left; None: as saved.
    """

    scene: OpenScene
    crop: Corners | None
    near: float
    path: CameraPath
    annotations: Annotations | None = None


@dataclass
class Shelf:
    """packs: in the order in which Ctrl+Tab comes to them. asked: the list of them shall be shown."""

    packs: list[Shelved] = field(default_factory=list)
    asked: bool = False

    def add(self, entry: Shelved, *, first: bool = False) -> list[str]:
        """Keeps a pack; the names of those that there is no room for any more.

        first: as the next one, not as the last.
        """
        self.drop(entry.scene.path)
        self.packs.insert(0 if first else len(self.packs), entry)
        gone = []
        while len(self.packs) > MOST_PACKS or (sum(map(_bytes, self.packs)) > MOST_BYTES and self.packs):
            oldest = self.packs.pop(-1 if first else 0)
            gone.append(oldest.scene.name)
        return gone

    def keep(self, app: App, entry: Shelved, *, first: bool = False) -> None:
        """Keeps a pack, and logs what had to go for it."""
        for name in self.add(entry, first=first):
            app.messages.log(f"{name} is closed, for there is no room for more open packs")

    def switch(self, app: App, step: int) -> None:
        """Shows the next open pack (step 1), or the one before (-1)."""
        if self.packs:
            self.switch_to(app, self.packs[0 if step > 0 else -1], backwards=step < 0)
        else:
            app.messages.say("No other pack is open")

    def switch_to(self, app: App, entry: Shelved, *, backwards: bool = False) -> None:
        """Shows an open pack. backwards: the one that is left becomes the next one, not the last."""
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
        """Forgets the pack of a path, if it is there: it is being opened anew."""
        self.packs = [entry for entry in self.packs if entry.scene.path.resolve() != path.resolve()]


def _bytes(entry: Shelved) -> int:
    return bytes_of(entry.scene.pack)


def bytes_of(pack: Pack) -> int:
    """What a pack holds of the computer's memory."""
    features = pack.atlas_features
    return pack.atlas_rgba.nbytes + pack.atlas_indices.nbytes + (features.nbytes if features is not None else 0)
