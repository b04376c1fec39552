"""Looking at two things in one place: the picture against a photograph, or against another pack."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from PIL import Image

from scenepack.pack import Pack
from viewer.app.photographs import Photographs, psnr
from viewer.app.rig import fitted
from viewer.app.state import name_of
from viewer.app.thumbnails import Thumbnails

if TYPE_CHECKING:
    from viewer.app.application import App

Against = Literal["", "photograph", "pack"]
How = Literal["wipe", "flip", "difference"]
FLIP_S = 0.7
PSNR_BUDGET_MS = 400.0  # what the figure may cost; the photograph is shrunk on slow cards


@dataclass
class Comparison:
    """against: what the picture is compared with. how: beside, in turn, or subtracted.

    split: 0 … 1, where the wipe's edge is. gain: how much a difference is amplified. photograph: index into the shots, of
    the one chosen last; it stays chosen when the camera moves away. reveal: the list has yet to scroll to it.
    frusta_size: over the usual one. frusta_opacity: 0 … 1, of the pictures in the frusta.
    """

    against: Against = ""
    how: How = "wipe"
    split: float = 0.5
    gain: float = 4.0
    photographs: Photographs | None = None
    photograph: int | None = None
    reveal: bool = False
    thumbnails: Thumbnails | None = None
    frusta: bool = False
    frusta_size: float = 1.0
    frusta_opacity: float = 0.9
    split_shown: str = ""  # only shots of this split; "" = all
    pixels: np.ndarray | None = None
    other: Pack | None = None
    other_path: Path | None = None
    psnr_db: float | None = None
    psnr_size: tuple[int, int] = (0, 0)
    clock: float = 0.0
    _measured: tuple[object, ...] = field(default=())

    def scene_changed(self, pack: Pack) -> None:
        """Another pack is shown: its photographs are others."""
        self.photographs = Photographs(pack)
        self.stop()
        self.photograph, self.frusta, self.split_shown = None, False, ""

    def stop(self) -> None:
        """Shows the picture alone."""
        self.against, self.pixels, self.psnr_db, self._measured = "", None, None, ()

    def stand_in(self, app: App, index: int) -> None:
        """Puts the camera where a photograph was taken, and the photograph beside the picture if it can be read."""
        if app.scene is None or self.photographs is None:
            return
        shot = self.photographs.shots[index]
        app.scene.rig.hold(shot.view, remember=True)
        if self.split_shown not in ("", shot.split):
            self.split_shown = ""
        self.reveal = True
        self.photograph, self.psnr_db, self._measured, self.pixels = index, None, (), None
        app.touch()
        self.against = ""
        if not self.photographs.has_picture(index):  # its place is all there is to see
            return
        self.pixels = self.photographs.pixels(index)
        self.against = "photograph"

    def visible(self) -> list[int]:
        """The shots of the split that is shown."""
        shots = self.photographs.shots if self.photographs is not None else []
        return [index for index, shot in enumerate(shots) if self.split_shown in ("", shot.split)]

    def step(self, app: App, by: int) -> None:
        """Stands in the next photograph of those that are shown, or in the one before."""
        visible = self.visible()
        if not visible:
            return
        first = 0 if by > 0 else -1
        place = visible.index(self.photograph) + by if self.photograph in visible else first
        self.stand_in(app, visible[place % len(visible)])

    def with_pack(self, app: App, pack: Pack, path: Path) -> None:
        """Compares with another pack under the same camera. UserError where the card has no room for both."""
        if app.stage is not None:
            with app.noting_warnings():
                app.stage.show_other(pack)
        self.other, self.other_path = pack, path
        self.against, self.photograph, self.pixels, self.psnr_db = "pack", None, None, None
        app.touch()

    def drop_other(self, app: App) -> None:
        """Ends the comparison with another pack."""
        if app.stage is not None:
            app.stage.show_other(None)
        self.other = self.other_path = None
        if self.against == "pack":
            self.stop()
        app.touch()

    @property
    def other_side(self) -> bool:
        """Whether a flip shows the other picture at this moment."""
        return int(self.clock / FLIP_S) % 2 == 1

    def sides(self, app: App) -> tuple[str, str] | None:
        """What is seen left and right of a wipe's edge, and in turn; None while nothing is compared."""
        if self.against == "photograph" and self.pixels is not None:
            return "Rendered", "Photograph"
        if self.against == "pack" and self.other_path is not None and app.scene is not None:
            return app.scene.name, name_of(self.other_path)
        return None

    def tick(self, app: App, seconds: float) -> None:
        """Time passes. Moving away from a photograph's place ends the comparison with it."""
        self._follow_thumbnails(app)
        if self.against == "photograph" and (app.scene is None or app.scene.rig.held is None):
            self.stop()
            app.touch()
        if self.against and self.how == "flip":
            side = self.other_side
            self.clock += seconds
            app.touch(1 if side == self.other_side else 3)

    def _follow_thumbnails(self, app: App) -> None:
        """Has them read while they are wanted, and drawn as they arrive."""
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

    def box(self, app: App) -> tuple[float, float, float, float]:
        """Where the photograph lies on the viewport: x0, y0, x1, y1 in 0 … 1 from the top left."""
        if self.against != "photograph" or self.pixels is None:
            return 0.0, 0.0, 1.0, 1.0
        width, height = app.viewport.pixels
        h, w = self.pixels.shape[:2]
        scale = min(width / w, height / h)
        x, y = 0.5 * (1 - scale * w / width), 0.5 * (1 - scale * h / height)
        return x, y, 1 - x, 1 - y

    def measure(self, app: App) -> None:
        """Brings the PSNR against the photograph up to date; call while nothing moves."""
        if self.against != "photograph" or self.pixels is None or app.stage is None or app.scene is None:
            return
        held = app.scene.rig.held
        key = (self.photograph, app.settings, id(held))
        if held is None or key == self._measured:
            return
        self._measured = key
        h, w = self.pixels.shape[:2]
        speed = app.resolution.pixels_per_ms or 1000.0
        scale = min(1.0, (PSNR_BUDGET_MS * speed / (w * h)) ** 0.5)
        size = max(1, round(w * scale)), max(1, round(h * scale))
        photograph = self.pixels
        if size != (w, h):
            photograph = np.asarray(Image.fromarray(photograph).resize(size, Image.Resampling.BOX))
        picture = app.stage.snapshot(fitted(held, size, app.settings.near), app.settings)
        self.psnr_db, self.psnr_size = psnr(picture, photograph), size
        app.touch()
