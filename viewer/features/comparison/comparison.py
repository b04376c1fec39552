"""Comparison of the picture with a photograph, or with another pack."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from PIL import Image

from scenepack.pack import Pack
from viewer.core.pose import fitted
from viewer.core.state import name_of
from viewer.features.photographs.photographs import psnr

if TYPE_CHECKING:
    from viewer.app.application import App

Against = Literal["", "photograph", "pack"]
How = Literal["wipe", "flip", "difference"]
FLIP_S = 0.7
PSNR_BUDGET_MS = 400.0  # what the figure may cost; the photograph is shrunk on slow GPUs


@dataclass
class Comparison:
    against: Against = ""
    how: How = "wipe"  # beside, in turn, or subtracted
    split: float = 0.5  # 0 … 1, where the wipe's edge is
    gain: float = 4.0  # how much a difference is amplified
    pixels: np.ndarray | None = None  # the photograph's, uint8 [h, w, 3], for as long as its camera is held
    other_path: Path | None = None  # of the other pack, which the canvas has
    psnr_db: float | None = None  # against the photograph
    psnr_size: tuple[int, int] = (0, 0)  # width, height that it was measured at
    clock: float = 0.0
    _measured: tuple[object, ...] = field(default=())

    def stop(self) -> None:
        """Shows the picture alone."""
        self.against, self.pixels, self.psnr_db, self._measured = "", None, None, ()

    def with_pack(self, app: App, pack: Pack, path: Path) -> None:
        """Compares with another pack under the same camera. UserError where the GPU has no room for both."""
        if app.canvas is not None:
            with app.messages.noting_warnings():
                app.canvas.show_other(pack)
        self.stop()
        self.other_path, self.against, app.gallery.chosen = path, "pack", None
        app.touch()

    def drop_other(self, app: App) -> None:
        if app.canvas is not None:
            app.canvas.show_other(None)
        self.other_path = None
        if self.against == "pack":
            self.stop()

    @property
    def other_side(self) -> bool:
        return int(self.clock / FLIP_S) % 2 == 1

    def sides(self, app: App) -> tuple[str, str] | None:
        """What is seen left and right of a wipe's edge, and in turn; None while nothing is compared."""
        if self.against == "photograph" and self.pixels is not None:
            return "Rendered", "Photograph"
        if self.against == "pack" and self.other_path is not None and app.scene is not None:
            return app.scene.name, name_of(self.other_path)
        return None

    def shows_other_pack(self, app: App, x: float) -> bool:
        """Whether the other pack is what is seen at x, in window units from the left edge of the picture."""
        other = {"wipe": x > self.split * app.viewport.width, "flip": self.other_side}
        return self.against == "pack" and other.get(self.how, False)

    def tick(self, app: App, seconds: float) -> None:
        """Advances flips; ends the comparison with a photograph once the camera moves."""
        if self.against == "photograph" and (app.scene is None or app.scene.rig.held is None):
            self.stop()
            app.touch()
        if self.against and self.how == "flip":
            side = self.other_side
            self.clock += seconds
            app.touch(1 if side == self.other_side else 3)

    def box(self, app: App) -> tuple[float, float, float, float]:
        """The photograph's box on the viewport: x0, y0, x1, y1 in 0 … 1 from the top left."""
        assert self.pixels is not None
        width, height = app.viewport.pixels
        h, w = self.pixels.shape[:2]
        scale = min(width / w, height / h)
        x, y = 0.5 * (1 - scale * w / width), 0.5 * (1 - scale * h / height)
        return x, y, 1 - x, 1 - y

    def measure(self, app: App) -> None:
        """Updates the PSNR against the photograph; call while nothing moves."""
        if self.against != "photograph" or self.pixels is None or app.canvas is None or app.scene is None:
            return
        held = app.scene.rig.held
        key = (app.settings, id(held))
        if held is None or key == self._measured:
            return
        self._measured = key
        h, w = self.pixels.shape[:2]
        speed = app.resolution.pixels_per_ms or 1000.0
        scale = min(1.0, (PSNR_BUDGET_MS * speed / (w * h)) ** 0.5)
        size = max(1, round(w * scale)), max(1, round(h * scale))
        photograph = np.asarray(Image.fromarray(self.pixels).resize(size, Image.Resampling.BOX))
        plain = replace(app.settings, backdrop=None)  # as photographs are
        picture = app.canvas.snapshot(fitted(held, size), plain)
        self.psnr_db, self.psnr_size = psnr(picture, photograph), size
        app.touch()
