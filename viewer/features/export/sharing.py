"""Shares the open pack: a process that serves it as a web page, and what the page shows besides the pack."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from console import UserError
from scenepack.exports.field import Corners
from viewer.core.command_process import FolderProcess
from viewer.core.files import kind_of
from viewer.core.state import OpenScene
from viewer.features.film.camera_path import save_path

if TYPE_CHECKING:
    from viewer.app.application import App


def check_is_on_disk(scene: OpenScene, remedy: str) -> None:
    """UserError where the scene is no pack that another process can read, as it is shown."""
    if kind_of(scene.path) != "pack":
        raise UserError("is not a pack on disk", where=scene.path, remedy=remedy)
    if scene.edits.removed.bits:
        raise UserError("lacks what was erased only here", where=scene.name, remedy="save it on the Erase page first")


def crop_words(crop: Corners | None) -> list[str]:
    """The option for a box, if there is one."""
    return [] if crop is None else ["--crop=" + ",".join(f"{number:.9g}" for corner in crop for number in corner)]


def page_words(app: App, folder: Path) -> list[str]:
    """Options for a page that begins with the view of this moment. folder: takes the camera path, where there is one."""
    assert app.scene is not None
    filming, file = app.filming, folder / "path.json"
    words = [f"--title={app.scene.name}", f"--pose={app.pose_text()}"]
    if not filming.path.keyframes:
        return words
    save_path(filming.path, file, app.scene.pack.worldspace_T_opengl, filming.size, filming.fps)
    return [*words, "--path", str(file)]


@dataclass
class Server(FolderProcess):
    name: str = ""  # of the pack
    address: str = ""  # what to open in a browser; "" until it is known


@dataclass
class Sharing:
    server: Server | None = None  # None while nothing is shared

    def start(self, app: App) -> None:
        """Serves the open pack, instead of what is served now. UserError where it is not on disk or nothing can be started."""
        if app.scene is None:
            return
        check_is_on_disk(app.scene, "open a pack, then share it")
        self.end()
        app.annotations.save_now()
        words = [str(app.scene.path.resolve()), "--serve", "0", *crop_words(app.settings.crop)]
        self.server = Server.start("viewer.commands.view", lambda folder: [*words, *page_words(app, folder)])
        self.server.name = app.scene.name
        app.touch()

    def copy(self, app: App) -> None:
        if self.server is not None:
            app.clipboard.set(self.server.address)
            app.messages.say("The address is on the clipboard")

    def end(self) -> None:
        """Stops serving; the process is gone after this."""
        server, self.server = self.server, None
        if server is not None:
            server.end()

    def tick(self, app: App) -> None:
        """Time passes: looks for the address, and whether the process has ended by itself."""
        server = self.server
        if server is None or not server.due():
            return
        if server.child.poll() is not None:
            app.messages.fail(f"{server.name} is not shared", server.child.error_line().removeprefix("snerg-view: "))
            self.end()
            app.touch()
        elif not server.address:
            lines = server.child.log.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
            found = [line.strip() for line in lines if line.startswith("http://") and line.endswith("\n")]
            server.address = found[0] if found else ""
            app.touch(1)
