"""The scene for others: as a mesh, points or Gaussians, as a web page in a file, or as one that is served.

A process writes or serves it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from console import UserError
from scenepack.exports.field import Corners, Frame, Keep
from scenepack.pack import Pack
from viewer.core.files import FileRequest, kind_of
from viewer.core.state import OpenScene
from viewer.core.tasks import Cancelled, FolderProcess, Task
from viewer.features.film.camera_path import save_path

if TYPE_CHECKING:
    from scenepack.exports.scene import Export, Geometry
    from viewer.app.application import App

Kind = Literal["mesh", "points", "gaussians", "page"]
SUFFIXES: dict[Kind, tuple[str, ...]] = {
    "mesh": (".glb", ".ply"),
    "points": (".ply",),
    "gaussians": (".ply", ".spz"),
    "page": (".html",),
}
FACES = {100_000: "100,000", 500_000: "500,000", 0: "All"}  # triangles of a mesh, at most
SPACINGS = {0.5: "Dense", 1.0: "Usual", 2.0: "Sparse"}  # of points, in voxels
KEPT: dict[Keep, str] = {"all": "All", 0.001: "Large", "largest": "Largest"}  # components of the surface
LEVELS = (0.02, 0.9)  # of opacity, that the slider has


def check_is_on_disk(scene: OpenScene, remedy: str) -> None:
    """UserError where the scene is no pack that another process can read, as it is shown."""
    if kind_of(scene.path) != "pack":
        raise UserError("is not a pack on disk", where=scene.path, remedy=remedy)
    if scene.edits.removed.bits:
        raise UserError("what you erased is not saved", where=scene.name, remedy="save it on the Erase page first")


def crop_words(crop: Corners | None) -> list[str]:
    """The option for a box, if there is one."""
    return [] if crop is None else ["--crop=" + ",".join(f"{number:.9g}" for corner in crop for number in corner)]


def page_words(app: App, folder: Path) -> list[str]:
    """Options for a page that begins with the view of this moment. folder: takes the camera path, where there is one."""
    filming, file = app.filming, folder / "path.json"
    words = [f"--title={app.open_scene.name}", f"--pose={app.pose_text()}"]
    if not filming.path.keyframes:
        return words
    save_path(filming.path, file, app.open_scene.pack.worldspace_T_opengl, filming.size, filming.fps)
    return [*words, "--path", str(file)]


@dataclass
class ExportPlan:
    """What to write: options of snerg-pack export. crop: whether only what is in the crop box."""

    kind: Kind = "mesh"
    level: float = 0.15
    faces: int = 500_000  # a key of FACES, as the next two of SPACINGS and KEPT
    spacing: float = 1.0
    keep: Keep = 0.001
    smooth: bool = True
    frame: Frame = "placed"
    crop: bool = True

    def arguments(self, pack: Path, file: Path, crop: Corners | None) -> list[str]:
        """Of `snerg-pack`. crop: the box that is shown, if there is one."""
        cropped = crop if self.crop else None
        words = ["export", str(pack), "--to", str(file), *crop_words(cropped)]
        if self.kind != "page":
            words += ["--kind", self.kind, "--frame", self.frame]
        if self.kind in ("mesh", "points"):
            words += ["--level", f"{self.level:g}", "--keep", str(self.keep)]
            words += [] if self.smooth else ["--smooth", "0"]
        words += ["--faces", str(self.faces)] * (self.kind == "mesh")
        words += ["--spacing", f"{self.spacing:g}"] * (self.kind == "points")
        return words

    def export(self, crop: Corners | None) -> Export:
        """The same as `arguments`, for a preview, which is in the grid frame."""
        from scenepack.exports.scene import Export

        assert self.kind != "page"
        return Export(
            self.kind, level=self.level, keep=self.keep, smooth=Export.smooth if self.smooth else 0, faces=self.faces,
            spacing=self.spacing, crop=crop if self.crop else None,
        )  # fmt: skip


@dataclass
class Writing(FolderProcess):
    file: Path  # what it writes
    then: Callable[[], object] = lambda: None  # called once it is there


@dataclass
class Exporting:
    plan: ExportPlan = field(default_factory=ExportPlan)  # the choices of the dialog, which stay
    preview: ExportPreview | None = None  # of these, while the dialog is open
    writing: Writing | None = None

    def ask(self, app: App) -> None:
        """Opens the dialog. UserError where the scene is no pack on disk, or something is being written."""
        self._check_is_idle()
        check_is_on_disk(app.open_scene, "open a pack, then export it")
        self.plan.crop = True
        self.preview = ExportPreview()

    def dismiss(self) -> None:
        if self.preview is not None:
            self.preview.close()
        self.preview = None

    def choose_file(self, app: App) -> None:
        self.dismiss()
        suffixes = SUFFIXES[self.plan.kind]
        name = f"{app.open_scene.name}-{self.plan.kind}{suffixes[0]}"
        app.file_request = FileRequest("Export the scene", "save", lambda path: self.begin(app, path), suffixes, name)

    def begin(self, app: App, file: Path) -> None:
        """Starts to write `file` in a process of its own. UserError where it cannot be started."""
        if app.scene is None:
            return
        words = self.plan.arguments(app.scene.path.resolve(), file.absolute(), app.settings.crop)
        is_page = self.plan.kind == "page"
        self.write(app, file, lambda folder: words + page_words(app, folder) if is_page else words)

    def write(
        self, app: App, file: Path, words: Callable[[Path], Sequence[str]], then: Callable[[], object] = lambda: None
    ) -> None:
        """Has snerg-pack write `file`. words: as of FolderProcess. then: called once it is there. UserError as begin()."""
        self._check_is_idle()
        app.annotations.save_now()
        self.writing = Writing.start("pack", words, file=file, then=then)
        app.touch()

    def _check_is_idle(self) -> None:
        if self.writing is not None:
            raise UserError("another export is still running", remedy="cancel it or wait for it")

    def cancel(self) -> None:
        """Asks the process to end; nothing of the file is left."""
        if self.writing is not None:
            self.writing.child.kill() if self.writing.child.stopping else self.writing.child.stop()

    def end(self) -> None:
        self.dismiss()
        if self.writing is not None:
            self.writing.end()
        self.writing = None

    def tick(self, app: App) -> None:
        """Time passes: looks at what the process is doing, and at the preview."""
        if self.preview is not None and app.scene is not None:
            if self.plan.kind != "page":  # that looks like the scene
                self.preview.follow(app.scene.pack, self.plan.export(app.settings.crop))
            if self.preview.news():
                app.touch(1)
        writing = self.writing
        if writing is None:
            return
        before, status = writing.child.report, writing.child.poll()
        if status is not None or writing.child.report != before:
            app.touch(1)
        if status is None:
            return
        if status == 0:
            app.messages.say(f"Saved {writing.file}")
            writing.then()
        elif writing.child.stopping:
            app.messages.say("The export was cancelled")
        else:
            app.messages.fail(f"{writing.file.name} was not written", writing.child.error_line())
        self.writing = None
        writing.end()


# --- Preview ---

SETTLED_S = 0.25  # without a change, before it is begun: sliders pass through many values


class ExportPreview:
    def __init__(self) -> None:
        self.geometry: Geometry | None = None  # the newest one, also while another is made
        self.error = ""  # why there is none of what is wanted
        self.share = 0.0  # of what is being made is done, 0 … 1
        self._wanted: tuple[int, Export] | None = None
        self._changed, self._begun = 0.0, True
        self._task: Task[None] | None = None  # what is superseded ends at its next report
        self._seen: object = None

    @property
    def working(self) -> bool:
        """Whether another preview is wanted and not there yet."""
        return not self._begun or (self._task is not None and not self._task.finished)

    def follow(self, pack: Pack, export: Export) -> None:
        """What is wanted now. Call it often."""
        wanted = (id(pack), export)
        if wanted != self._wanted:
            self._wanted, self._changed, self._begun = wanted, time.monotonic(), False
        first, busy = self.geometry is None and not self.error, self._task is not None and not self._task.finished
        if not self._begun and not busy and (first or time.monotonic() - self._changed >= SETTLED_S):
            self._begun, self.share = True, 0.0
            self._task = Task(lambda: self._make(pack, wanted))

    def news(self) -> bool:
        """Whether there is something else to show since this was asked last."""
        state = (self.geometry, self.error, self.working, round(50 * self.share))
        before, self._seen = self._seen, state
        return before != state

    def close(self) -> None:
        self._wanted = None

    def _make(self, pack: Pack, wanted: tuple[int, Export]) -> None:
        from scenepack.exports.scene import preview_geometry

        def on_progress(share: float, note: str) -> None:
            if self._wanted != wanted:
                raise Cancelled  # something else is wanted by now
            self.share = share

        try:
            made = preview_geometry(pack, wanted[1], on_progress)
            on_progress(1.0, "")
            self.geometry, self.error = made, ""
        except (UserError, MemoryError) as error:
            self.error = error.what if isinstance(error, UserError) else "there is not enough memory for a preview"


# --- Sharing ---


@dataclass
class Server(FolderProcess):
    name: str  # of the pack
    address: str = ""  # what to open in a browser; "" until it is known


@dataclass
class Sharing:
    server: Server | None = None  # None while nothing is shared

    def start(self, app: App) -> None:
        """Serves the open pack, instead of what is served now. UserError where it is not on disk or nothing can be started."""
        scene = app.open_scene
        check_is_on_disk(scene, "open a pack, then share it")
        self.end()
        app.annotations.save_now()
        words = [str(scene.path.resolve()), "--serve", "0", *crop_words(app.settings.crop)]
        self.server = Server.start("view", lambda folder: [*words, *page_words(app, folder)], name=scene.name)

    def end(self) -> None:
        server, self.server = self.server, None
        if server is not None:
            server.end()

    def tick(self, app: App) -> None:
        """Time passes: looks for the address, and whether the process has ended by itself."""
        server = self.server
        if server is None:
            return
        if server.child.poll() is not None:
            app.messages.fail(f"{server.name} is not shared", server.child.error_line())
            self.end()
            app.touch()
        elif not server.address:
            printed = server.child.log.read_text(encoding="utf-8", errors="replace")
            server.address = next(iter(re.findall(r"^(http://.*)\n", printed, re.MULTILINE)), "")
            if server.address:
                app.touch(1)
