"""snerg-view: the desktop viewer, or an orbit rendered to files where there is no display."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from console import UserError, run_command
from console.command_line import parse_crop, parse_size
from console.desktop import tell_if_unseen
from scenepack.reader import load_pack
from viewer.app.application import App
from viewer.commands.render import fly_over
from viewer.core import annotations
from viewer.core.files import demo_pack, kind_of, scene_around
from viewer.core.log import CrashLog, default_folder, left_behind
from viewer.core.pose import pose_from_text
from viewer.core.state import name_of
from viewer.desktop import desktop_entry
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.comparison.comparison import How
from viewer.features.film.filming import Kiosk
from viewer.features.film.picture_export import PNG
from viewer.features.making import survey
from viewer.features.opening import session
from viewer.features.preferences import preferences
from viewer.features.preferences.preferences import PreferencesAutosave, apply_preferences
from viewer.interface.layout import PAGES
from viewer.rendering.settings import Marcher, Mode, RenderSettings
from viewer.web.description import PageContent, with_annotations
from viewer.web.page import serve
from viewer.window.window import SIGNALED, NoDisplay, Window, on_lost_display, require_display, signals_ask

OUT = Path("out")
SCRIPTED = ("--frames", "--screenshot")
SERVED_ON = 8090  # port
SMALLEST_SIDE = 64  # of a window, screen units
if TYPE_CHECKING:  # a Literal that is computed tells type checkers nothing
    PageName = str
else:
    PageName = Literal[*(page.id for page in PAGES)]


@dataclass(frozen=True)
class View:
    """Opens the desktop viewer. Without a display, it renders an orbit into out/ instead.

    Args:
        pack: Folder or .zip of a baked scene, or a saved session (.snerg). Without it, the start page opens. For a folder of
            photographs or a training run, the viewer offers to make a scene.
        mode: What to show first. "normal" is the picture.
        marcher: How rays skip empty space: exact (the default), paper (the paper's algorithm), or brute (takes every sample). The
            Performance page has it, too.
        surroundings: Whether to show what lies beyond the inner cube of an unbounded scene.
        pose: First camera: a pose copied from the viewer, or x,y,z,x,y,z of eye and target in the grid frame (y up).
        compare: Another pack, shown under the same camera.
        photographs: Folder of the scene that the pack was made from. The default is the folder that the pack names.
        photograph: Photograph whose camera to use: its name, or the start or end of its name.
        look: How to compare the picture with the photograph or the other pack.
        path: Camera path to load, as nerfstudio's viewer saves it (JSON).
        export: Write a .png of the view, or the camera path as .mp4, .webp, .gif or into a new folder. Without a path,
            a turntable.
        export_size: Size of the export, WIDTHxHEIGHT in pixels, for example 1920x1080.
        page: Page of the side panel to open.
        kiosk: Full screen, without panels: play the camera path, the bookmarks or a turn, and again a minute after somebody moved
            the camera. Ctrl+Q quits.
        size: Window size in screen units, for example 1280x800. The default is the last size.
        frames: For scripts: draw this many frames, wait until the picture is sharp, and quit.
        screenshot: For scripts: before quitting, save the window with its panels as this PNG. Implies --frames 1.
        serve: Show the pack as a web page on this port instead of opening a window. Without a number: 8090. Of a run that trains,
            its previews.
        host: Address to serve it on. The default is reached from this computer alone.
        title: Heading of the page that is served. The default is the pack's name.
        credits: Line below the heading.
        crop: Of the page, only what is in the box x0,y0,z0,x1,y1,z1 of the grid frame.
        register: Add the viewer to the menus of your Linux desktop, and to the programs that open packs and folders.
        unregister: Take it out again.
    """

    pack: Annotated[Path | None, tyro.conf.Positional] = None
    mode: Mode = "normal"
    marcher: Marcher = "exact"
    surroundings: bool = True
    pose: str | None = None
    compare: Path | None = None
    photographs: Path | None = None
    photograph: str | None = None
    look: How | None = None
    path: Path | None = None
    export: Path | None = None
    export_size: str | None = None
    page: PageName | None = None
    kiosk: bool = False
    size: str | None = None
    frames: int | None = None
    screenshot: Path | None = None
    serve: int | None = None
    host: str = "127.0.0.1"
    title: str | None = None
    credits: str = ""
    crop: str | None = None
    register: bool = False
    unregister: bool = False

    def run(self) -> int:
        """Shows the window until it is closed; the exit status."""
        if self.register or self.unregister:
            if self.unregister:
                said = [f"removed {path}" for path in desktop_entry.unregister()]
            else:
                said = desktop_entry.register(desktop_entry.own_command())
            print(*(said or ["snerg-view: nothing was registered"]), sep="\n")
            return 0
        if self.serve is not None:
            box = None if self.crop is None else parse_crop(self.crop)
            content = PageContent(self.title or "", self.credits, self.path, box, self.pose)
            serve(self.pack or demo_pack(), self.host, self.serve, content)
            return 0
        frames = 1 if self.frames is None and self.screenshot is not None else self.frames
        window_size = parse_size(self.size, least=SMALLEST_SIDE) if self.size else None
        if frames is not None and frames < 1:
            raise UserError("is too small", where="--frames", expected="1 or more", found=frames)
        if self.export_size is not None:
            parse_size(self.export_size, "--export-size")
        if self.pose is not None:
            try:
                pose_from_text(self.pose)
            except ValueError as error:
                raise UserError(str(error), where="--pose") from error
        for name in ("pose", "compare", "photographs", "photograph", "path", "export", "kiosk"):
            if self.pack is None and getattr(self, name) not in (None, False):
                raise UserError("needs a pack", where=f"--{name}", expected=f"snerg-view PACK --{name} …")
        try:
            return _show_window(self, window_size, frames)
        except NoDisplay as reason:
            if frames is not None or self.export is not None:
                raise UserError(str(reason), remedy="start it with xvfb-run, or use snerg-render") from reason
            settings = RenderSettings(mode=self.mode, marcher=self.marcher, surroundings=self.surroundings)
            _render_instead(self.pack, settings, reason)
            return 0

    # What was asked for is carried out step by step once there is something to carry it out on. Whatever fails is a dialog, like
    # everything else that fails in the window.

    def begin(self, app: App) -> None:
        """Starts to open the pack; the rest follows when it is there."""
        app.set(mode=self.mode, marcher=self.marcher)
        if not self.surroundings:
            app.set(surroundings=False)
        photographs = self.photographs or self.photograph
        meant = {"film": self.path or self.export, "compare": self.compare, "photographs": photographs}
        page = self.page or next((name for name, given in meant.items() if given), None)
        if page is not None:
            app.interface.opens(page)
        if self.kiosk:
            app.kiosk = Kiosk()
            app.interface.full_screen, app.interface.panels_shown = True, False
        if self.look is not None:
            app.comparison.how = self.look
        if self.pack is not None and kind_of(self.pack) in ("scene", "run", "pictures", "session"):
            app.drop([self.pack])
        elif self.pack is not None:
            app.open(self.pack, then=lambda: self._opened(app))

    def _opened(self, app: App) -> None:
        if self.pose is not None:
            with app.messages.as_dialog("--pose"):
                app.go_to_pose(self.pose)
        if self.photographs is not None or self.photograph is not None:
            with app.messages.as_dialog("The photographs cannot be shown"):
                self._show_photographs(app)
        if self.path is not None:
            with app.messages.as_dialog("The camera path cannot be read"):
                app.filming.load(app, self.path)
        if self.compare is not None:
            app.open(self.compare, other=True, then=lambda: self._export(app))
        else:
            self._export(app)

    def _show_photographs(self, app: App) -> None:
        photographs, gallery = app.gallery.photographs, app.gallery
        if self.photographs is not None:
            photographs.look_in(self.photographs)
        if not photographs.shots:
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
        if self.export is None:
            return
        rig, filming = app.open_scene.rig, app.filming
        with app.messages.as_dialog("The export cannot be started"):
            if self.export_size is not None:
                filming.size = parse_size(self.export_size, "--export-size")
            width, height = filming.size
            rig.shape(width / height)  # the film's, not the window's: that has none yet, or one that changes
            if self.export.suffix.lower() == PNG:
                filming.still(app, self.export, rig.camera(filming.size, app.settings.near))
                return
            if not filming.path.keyframes:
                filming.turntable(app)
            filming.film(app, self.export)


def _show_window(view: View, size: tuple[int, int] | None, frames: int | None) -> int:
    """Runs the viewer until it is closed, or for so many frames; the exit status. NoDisplay; UserError of a script's failure."""
    require_display()
    app = App(demo=demo_pack())
    if frames is None:
        return _live(app, view, size)
    survey.MEASURES = False  # a picture that says how long something takes is another one each time
    with Window(app, size or app.preferences.window) as window:  # the same picture whatever was remembered
        view.begin(app)
        window.draw_frames(frames)
        if view.screenshot is not None:
            window.save_screenshot(view.screenshot)
            print(view.screenshot)
        window.finish_export()
    for dialog in app.messages.dialogs:  # nobody is there to read it
        if dialog.failed:
            raise UserError(f"{dialog.title}: {dialog.text}")
        print(f"snerg-view: warning: {dialog.text}", file=sys.stderr)
    return 0


def _live(app: App, view: View, size: tuple[int, int] | None) -> int:
    """A window until it is closed, or the program is ended from outside; the exit status."""
    file = preferences.default_file()
    crashed = left_behind(default_folder())
    with signals_ask(app.quit) as ended, _crash_log(app) as crash_log:
        apply_preferences(app, preferences.load(file))
        app.annotations.folder = annotations.default_folder()
        app.sessions.begin(session.default_file())
        with Window(app, size or app.preferences.window) as window:
            crash_log.add(f"OpenGL {window.ctx.info.get('GL_VERSION')} on {window.canvas.gpu_name}")
            if crashed:
                app.messages.say(f"The viewer ended unexpectedly the last time. Its log: {crashed[-1]}", "warning")
            view.begin(app)
            _keep(app, window, PreferencesAutosave(app, file, lambda: window.size, lambda: window.layout), crash_log)
    if signal.SIGINT in ended:
        raise KeyboardInterrupt
    return SIGNALED + ended[0] if ended else 0


@contextlib.contextmanager
def _crash_log(app: App) -> Iterator[CrashLog]:
    """Writes a crash log while the block runs, and removes it afterwards, unless a bug ended the block."""
    crash_log = CrashLog(default_folder())
    app.messages.crash_log = crash_log.add
    try:
        yield crash_log
    except Exception as error:
        if not isinstance(error, UserError | NoDisplay) and crash_log.crash(error):
            with contextlib.suppress(OSError):
                print(f"snerg-view: this crash is described in {default_folder()}", file=sys.stderr)
        raise
    finally:
        crash_log.end()


def _keep(app: App, window: Window, autosave: PreferencesAutosave, crash_log: CrashLog) -> None:
    """Runs the window; whatever ends it, what is to be remembered is saved."""

    def save(*, window: bool) -> str | None:
        app.sessions.finish(app)
        app.annotations.close_pack(app)
        return autosave.finish(window=window)

    def leave() -> None:
        save(window=False)
        app.making.end()
        crash_log.end()

    on_lost_display(leave)
    try:
        window.run(autosave.poll)
    finally:
        if problem := save(window=True):
            with contextlib.suppress(OSError):  # the terminal may be gone
                print(f"snerg-view: {problem}", file=sys.stderr)


def _render_instead(path: Path | None, settings: RenderSettings, reason: NoDisplay) -> None:
    chosen = path or demo_pack()
    if kind_of(chosen) == "session":
        chosen = session.load_session(chosen).packs[0].path
    chosen = scene_around(chosen)
    if kind_of(chosen) in ("scene", "run", "pictures"):
        command = "snerg-bake" if kind_of(chosen) == "run" else "snerg-make"
        raise UserError("is not a pack yet", where=chosen, remedy=f"make one: {command} {chosen} --out DIR")
    loaded = with_annotations(load_pack(chosen), chosen)
    print(f"snerg-view: {reason}; rendering an orbit into {OUT}/ instead", file=sys.stderr)
    for written in fly_over(loaded, name_of(chosen), OUT, orbit_camera_for(loaded).fov, settings):
        print(written)


def _with_port(words: Sequence[str]) -> list[str]:
    """The words with SERVED_ON behind a --serve that has no number."""
    joined = []
    for word, after in pairwise([*words, ""]):
        joined.append(f"{word}={SERVED_ON}" if word == "--serve" and not after.lstrip("-").isdigit() else word)
    return joined


def main(args: Sequence[str] | None = None) -> int:
    words = _with_port(sys.argv[1:] if args is None else args)
    scripted = any(word.startswith(SCRIPTED) for word in words)  # nobody is there to close a box
    return run_command(View, prog="snerg-view", args=words, on_failure=None if scripted else tell_if_unseen)
