"""Shares the open pack: a process that serves it as a web page, and what the page shows besides the pack."""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from console import UserError
from console.child_process import module_command
from scenepack.exports.field import Corners
from viewer.core.command_process import CommandProcess, temporary_folder
from viewer.core.files import kind_of
from viewer.core.pose import pose_to_text
from viewer.features.film.camera_path import save_path

if TYPE_CHECKING:
    from viewer.app.application import App

LOOK_EVERY_S, PARTING_S = 0.1, 5.0


def crop_words(crop: Corners | None) -> list[str]:
    """The option for a box, if there is one."""
    return [] if crop is None else ["--crop=" + ",".join(f"{number:.9g}" for corner in crop for number in corner)]


def page_words(app: App, folder: Path) -> list[str]:
    """Options for a page that begins with the view of this moment. folder: takes the camera path, where there is one."""
    assert app.scene is not None
    rig, filming = app.scene.rig, app.filming
    words = [f"--title={app.scene.name}", f"--pose={pose_to_text(rig.matrix, app.fov)}"]
    if filming.path.keyframes:
        file = folder / "path.json"
        save_path(filming.path, file, app.scene.pack.worldspace_T_opengl, filming.size, filming.fps)
        words += ["--path", str(file)]
    return words


@dataclass
class Server:
    """A process at work. folder: of its log. name: of the pack. address: what to open in a browser; "" until it is known."""

    child: CommandProcess
    folder: Path
    name: str
    address: str = ""


@dataclass
class Sharing:
    """server: None while nothing is shared."""

    server: Server | None = None
    _looked: float = 0.0

    def start(self, app: App) -> None:
        """Serves the open pack, instead of what is served now. UserError where it is not on disk or nothing can be started."""
        if app.scene is None:
            return
        if kind_of(app.scene.path) != "pack":
            raise UserError("is not a pack on disk", where=app.scene.path, remedy="open a pack, then share it")
        self.end()
        folder = temporary_folder("snerg-share-")
        try:
            words = [*crop_words(app.settings.crop), *page_words(app, folder)]
            path = str(app.scene.path.resolve())
            child = CommandProcess(
                module_command("viewer.commands.view", path, "--serve", "0", *words), folder / "log.txt"
            )
        except (OSError, UserError):
            shutil.rmtree(folder, ignore_errors=True)
            raise
        self.server = Server(child, folder, app.scene.name)
        app.touch()

    def copy(self, app: App) -> None:
        if self.server is not None:
            app.clipboard.set(self.server.address)
            app.messages.say("The address is on the clipboard")

    def end(self) -> None:
        """Stops serving; the process is gone after this."""
        server, self.server = self.server, None
        if server is not None:
            server.child.end(PARTING_S)
            shutil.rmtree(server.folder, ignore_errors=True)

    def tick(self, app: App) -> None:
        """Time passes: looks for the address, and whether the process has ended by itself."""
        server, now = self.server, time.monotonic()
        if server is None or now - self._looked < LOOK_EVERY_S:
            return
        self._looked = now
        if server.child.poll() is not None:
            app.messages.fail(f"{server.name} is not shared", server.child.error_line().removeprefix("snerg-view: "))
            self.end()
            app.touch()
        elif not server.address:
            lines = server.child.log.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
            found = [line.strip() for line in lines if line.startswith("http://") and line.endswith("\n")]
            server.address = found[0] if found else ""
            app.touch(1)
