"""What the command line of snerg-view asks for, carried out step by step once there is something to carry it out on.

Whatever fails is a dialog, like everything else that fails in the window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from console import UserError
from viewer.app.application import App
from viewer.app.comparison import How
from viewer.app.files import kind_of
from viewer.app.filming import Size
from viewer.rendering.settings import Mode

STILL_SUFFIX = ".png"


@dataclass(frozen=True)
class Startup:
    """pack: None leads to the start page.

    pose: as viewer.app.pose understands it. compare: another pack. photographs: a scene's folder. photograph: a name, or
    the beginning or end of one. look: how either is compared. path: a camera path's JSON. export: a .png of the view, or
    an .mp4 or a folder for the path's film, a turntable where there is none; export_size: its pixels. page: of the panel.
    """

    pack: Path | None = None
    mode: Mode = "normal"
    surroundings: bool = True
    pose: str | None = None
    compare: Path | None = None
    photographs: Path | None = None
    photograph: str | None = None
    look: How | None = None
    path: Path | None = None
    export: Path | None = None
    export_size: Size | None = None
    page: str | None = None

    def begin(self, app: App) -> None:
        """Starts to open the pack; the rest follows when it is there."""
        app.set(mode=self.mode)
        if not self.surroundings:
            app.set(surroundings=False)
        page = self.page or self._page()
        if page is not None:
            app.interface.opens(page)
        if self.look is not None:
            app.comparison.how = self.look
        if self.pack is not None and kind_of(self.pack) in ("scene", "run", "pictures", "session"):
            app.drop([self.pack])
        elif self.pack is not None:
            app.open(self.pack, then=lambda: self._opened(app))

    def _page(self) -> str | None:
        """The page that shows what was asked for."""
        if self.path or self.export:
            return "film"
        if self.compare:
            return "compare"
        return "photographs" if self.photographs or self.photograph else None

    def _opened(self, app: App) -> None:
        if self.pose is not None:
            _try(app, "--pose", lambda: app.paste_pose(self.pose))
        if self.photographs is not None or self.photograph is not None:
            _try(app, "The photographs cannot be shown", lambda: self._stand(app))
        if (path := self.path) is not None:
            _try(app, "The camera path cannot be read", lambda: app.filming.load(app, path))
        if self.compare is not None:
            app.open(self.compare, other=True, then=lambda: self._export(app))
        else:
            self._export(app)

    def _stand(self, app: App) -> None:
        photographs, gallery = app.gallery.photographs, app.gallery
        assert photographs is not None
        if self.photographs is not None:
            photographs.look_in(self.photographs)
        if not len(photographs):
            raise UserError("this pack has no camera poses", where=self.pack)
        gallery.frusta = True
        if self.photograph is not None:
            gallery.stand_in(app, photographs.named(self.photograph))
        elif self.look is not None:
            gallery.step(app, 1)
        if (self.photograph is not None or self.look is not None) and app.comparison.pixels is None:
            remedy = "name the scene's folder: --photographs SCENE"
            raise UserError("its photographs are not on this computer", where=self.pack, remedy=remedy)

    def _export(self, app: App) -> None:
        if self.export is not None:
            _try(app, "The export cannot be started", lambda: self._start_export(app))

    def _start_export(self, app: App) -> None:
        assert self.export is not None
        assert app.scene is not None
        if self.export_size is not None:
            app.filming.size = self.export_size
        width, height = app.filming.size
        app.scene.rig.shape(width / height)  # the film's, not the window's: that has none yet, or one that changes
        if self.export.suffix.lower() == STILL_SUFFIX:
            app.filming.still(app, self.export, app.scene.rig.camera(app.filming.size, app.settings.near))
            return
        if not app.filming.path.keyframes:
            app.filming.turntable(app)
        app.filming.film(app, self.export)


def _try(app: App, title: str, action: Callable[[], object]) -> None:
    try:
        action()
    except Exception as error:  # a dialog, and the program goes on
        app.messages.fail(title, error)
