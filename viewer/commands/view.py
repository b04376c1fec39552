"""snerg-view: the desktop viewer, or an orbit rendered to files where there is no display."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import tyro

from console import UserError, run_command
from console.arguments import join_negative_values, parse_size
from console.desktop import tell_if_unseen
from scenepack.reader import load_pack
from viewer.app import annotations, desktop_entry, make_plan, preferences, session
from viewer.app.application import App
from viewer.app.comparison import How
from viewer.app.crash_log import CrashLog, default_folder, left_behind
from viewer.app.files import kind_of, scene_around
from viewer.app.forward_facing import orbit_camera_for
from viewer.app.pose import pose_from_text
from viewer.app.preferences import PreferencesAutosave, apply_preferences
from viewer.app.startup import Startup
from viewer.app.state import name_of
from viewer.benchmark.flyover import fly_over
from viewer.panels.ui import Ui
from viewer.rendering.settings import Mode, RenderSettings
from viewer.window.shutdown import on_lost_display, signals_ask
from viewer.window.window import NoDisplay, Window, display_problem

DEMO = "demo.zip"
OUT = Path("out")
SCRIPTED = ("--frames", "--screenshot")
SMALLEST_SIDE = 64  # of a window, screen units
PageName = Literal[
    "view", "camera", "bookmarks", "crop", "measure", "photographs", "compare", "film", "performance", "settings", "log"
]


def demo_pack() -> Path | None:
    """The bundled demo pack, None where this installation has none."""
    path = Path(str(resources.files("viewer") / "demo" / DEMO))
    return path if path.is_file() else None


def view(
    pack: Annotated[Path | None, tyro.conf.Positional] = None,
    mode: Mode = "normal",
    surroundings: bool = True,
    pose: str | None = None,
    compare: Path | None = None,
    photographs: Path | None = None,
    photograph: str | None = None,
    look: How | None = None,
    path: Path | None = None,
    export: Path | None = None,
    export_size: str | None = None,
    page: PageName | None = None,
    size: str | None = None,
    frames: int | None = None,
    screenshot: Path | None = None,
    register: bool = False,
    unregister: bool = False,
) -> int:
    """Opens the desktop viewer. Without a display, it renders an orbit into out/ instead.

    Args:
        pack: Folder or .zip of a baked scene, or a saved session (.snerg). Without it, the start page opens. For a folder of
            photographs or a training run, the viewer offers to make a scene.
        mode: What to show first. "normal" is the picture.
        surroundings: Show what lies beyond the inner cube of an unbounded scene.
        pose: First camera: a pose copied from the viewer, or x,y,z,x,y,z of eye and target in the grid frame (y up).
        compare: Another pack, shown under the same camera.
        photographs: Folder of the scene that the pack was made from. The default is the folder that the pack names.
        photograph: Photograph whose camera to use: its name, or the start or end of its name.
        look: How to compare the picture with the photograph or the other pack.
        path: Camera path to load, as nerfstudio's viewer saves it (JSON).
        export: Write a .png of the view, or the camera path as .mp4 or into a new folder. Without a path, a turntable.
        export_size: Size of the export, WIDTHxHEIGHT in pixels, for example 1920x1080.
        page: Page of the side panel to open.
        size: Window size in screen units, for example 1280x800. The default is the last size.
        frames: For scripts: draw this many frames, wait until the picture is sharp, and quit.
        screenshot: For scripts: before quitting, save the window with its panels as this PNG. Implies --frames 1.
        register: Add the viewer to the menus of your Linux desktop, and to the programs that open packs and folders.
        unregister: Take it out again.
    """
    if register or unregister:
        return _register(register and not unregister)
    window_size = parse_size(size, least=SMALLEST_SIDE) if size else None
    if frames is not None and frames < 1:
        raise UserError("is too small", where="--frames", expected="1 or more", found=frames)
    if screenshot is not None and frames is None:
        frames = 1
    if pose is not None:
        _check_pose(pose)
    wishes = Startup(
        pack=pack,
        mode=mode,
        surroundings=surroundings,
        pose=pose,
        compare=compare,
        photographs=photographs,
        photograph=photograph,
        look=look,
        path=path,
        export=export,
        export_size=parse_size(export_size, "--export-size") if export_size else None,
        page=page,
    )
    if pack is None:
        _check_has_pack(wishes)
    try:
        return _show_window(wishes, Script(window_size, frames, screenshot))
    except NoDisplay as reason:
        if frames is not None or export is not None:
            raise UserError(str(reason), remedy="start it with xvfb-run, or use snerg-render") from reason
        _render_instead(pack, RenderSettings(mode=mode, surroundings=surroundings), reason)
        return 0


def _register(wanted: bool) -> int:
    """Writes or removes what Linux desktops know of the viewer."""
    if wanted:
        for path in desktop_entry.register(desktop_entry.own_command()):
            print(path)
        return 0
    gone = desktop_entry.unregister()
    for path in gone:
        print(f"removed {path}")
    if not gone:
        print("snerg-view: nothing was registered")
    return 0


@dataclass(frozen=True)
class Script:
    """How long the window lives. size: None means the remembered one. frames: None, until the user closes it."""

    size: tuple[int, int] | None
    frames: int | None
    screenshot: Path | None


def _check_pose(text: str) -> None:
    try:
        pose_from_text(text)
    except ValueError as error:
        raise UserError(str(error), where="--pose") from error


def _check_has_pack(wishes: Startup) -> None:
    for name in ("pose", "compare", "photographs", "photograph", "path", "export"):
        if getattr(wishes, name) is not None:
            raise UserError("needs a pack", where=f"--{name}", expected=f"snerg-view PACK --{name} …")


def _show_window(wishes: Startup, script: Script) -> int:
    """Runs the viewer until it is closed; the exit status. NoDisplay without one; UserError where a script met a failure."""
    problem = display_problem()
    if problem:
        raise NoDisplay(problem)
    app = App(demo=demo_pack())
    if script.frames is None:
        return _live(app, wishes, script.size)
    make_plan.MEASURES = False  # a picture that says how long something takes is another one each time
    with Window(app, Ui, script.size or app.preferences.window) as window:  # the same picture whatever was remembered
        wishes.begin(app)
        window.draw_frames(script.frames)
        if script.screenshot is not None:
            window.save_screenshot(script.screenshot)
            print(script.screenshot)
        window.finish_export()
    for dialog in app.messages.dialogs:  # nobody is there to read it
        if dialog.failed:
            raise UserError(f"{dialog.title}: {dialog.text}")
        print(f"snerg-view: warning: {dialog.text}", file=sys.stderr)
    return 0


def _live(app: App, wishes: Startup, size: tuple[int, int] | None) -> int:
    """A window until it is closed, or the program is ended from outside; the exit status."""
    file = preferences.default_file()
    crashed = left_behind(default_folder())
    with signals_ask(app.quit) as ended, _trail(app) as crash_log:
        apply_preferences(app, preferences.load(file))
        app.annotations.folder = annotations.default_folder()
        app.sessions.begin(session.default_file())
        with Window(app, Ui, size or app.preferences.window) as window:
            crash_log.add(f"OpenGL {window.ctx.info.get('GL_VERSION')} on {window.canvas.card}")
            if crashed:
                app.messages.say(f"The viewer ended unexpectedly the last time. Its log: {crashed[-1]}", "warning")
            wishes.begin(app)
            _keep(app, window, PreferencesAutosave(app, file, lambda: window.size, lambda: window.layout), crash_log)
    if ended.signal == signal.SIGINT:
        raise KeyboardInterrupt
    return ended.status


@contextlib.contextmanager
def _trail(app: App) -> Iterator[CrashLog]:
    """Within the block what is done is written down; the file is removed behind it, unless a bug ends it."""
    crash_log = CrashLog(default_folder())
    app.messages.crash_log = crash_log.add
    try:
        yield crash_log
    except (UserError, NoDisplay, KeyboardInterrupt, SystemExit):
        crash_log.end()
        raise
    except BaseException as error:
        path = crash_log.crash(error)
        if path is not None:
            with contextlib.suppress(OSError):
                print(f"snerg-view: this crash is described in {path.parent}", file=sys.stderr)
        raise
    crash_log.end()


def _keep(app: App, window: Window, autosave: PreferencesAutosave, crash_log: CrashLog) -> None:
    """Runs the window; whatever ends it, `keeper` has saved what is to be remembered."""

    def leave() -> None:
        autosave.finish(window=False)
        app.sessions.finish(app)
        app.annotations.close_pack()
        app.making.end()
        crash_log.end()

    if window.on_x11:
        on_lost_display(leave)
    try:
        window.run(autosave.poll)
    finally:
        app.sessions.finish(app)
        app.annotations.close_pack()
        problem = autosave.finish()
        if problem:
            with contextlib.suppress(OSError):  # the terminal may be gone
                print(f"snerg-view: {problem}", file=sys.stderr)


def _render_instead(path: Path | None, settings: RenderSettings, reason: NoDisplay) -> None:
    chosen = path or demo_pack()
    if chosen is None:
        raise UserError("there is no pack to render", remedy="name one: snerg-view PACK")
    if kind_of(chosen) == "session":
        chosen = session.load_session(chosen).packs[0].path
    chosen = scene_around(chosen)
    if kind_of(chosen) in ("scene", "run", "pictures"):
        command = "snerg-bake" if kind_of(chosen) == "run" else "snerg-make"
        raise UserError("is not a pack yet", where=chosen, remedy=f"make one: {command} {chosen} --out DIR")
    loaded = load_pack(chosen)
    print(f"snerg-view: {reason}; rendering an orbit into {OUT}/ instead", file=sys.stderr)
    for written in fly_over(loaded, name_of(chosen), OUT, orbit_camera_for(loaded).fov, settings):
        print(written)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of snerg-view; returns the exit status."""
    words = join_negative_values(sys.argv[1:] if args is None else args, ("--pose",))
    scripted = any(word.startswith(SCRIPTED) for word in words)  # nobody is there to close a box
    return run_command(view, prog="snerg-view", args=words, on_failure=None if scripted else tell_if_unseen)


if __name__ == "__main__":
    sys.exit(main())
