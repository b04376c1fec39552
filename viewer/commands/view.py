"""snerg-view: the desktop viewer, or an orbit rendered to files where there is no display."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated

import tyro

from console import UserError, run_command
from scenepack.pack import Pack
from scenepack.reader import load_pack
from viewer.app import preferences
from viewer.app.application import App, name_of
from viewer.app.pose import pose_from_text
from viewer.flyover import fly_over
from viewer.settings import Mode, RenderSettings
from viewer.window import NoDisplay, Window, display_problem

DEMO = "demo.zip"
OUT = Path("out")


def demo_pack() -> Path | None:
    """The bundled demo pack, None where this installation has none."""
    path = Path(str(resources.files("viewer") / "demo" / DEMO))
    return path if path.is_file() else None


def parse_size(text: str) -> tuple[int, int]:
    """ "1280x800" as (width, height) in screen units; UserError where it is no such thing."""
    match = re.fullmatch(r"(\d+)[x×](\d+)", text.strip())
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(64 <= side <= 16384 for side in size):
        raise UserError("is no window size", where="--size", expected="WxH such as 1280x800", found=repr(text))
    return size


def view(
    pack: Annotated[Path | None, tyro.conf.Positional] = None,
    frames: int | None = None,
    screenshot: Path | None = None,
    size: str | None = None,
    mode: Mode = "normal",
    pose: str | None = None,
) -> None:
    """Opens a pack in the desktop viewer. Without a display, renders an orbit of it into out/ instead.

    Args:
        pack: folder or .zip of a baked scene; without it, the bundled demo.
        frames: draw this many frames and quit (for scripts).
        screenshot: before quitting, save the window's picture, scene and panels, as this PNG; asks for --frames.
        size: of the window, in screen units, such as 1280x800; by default as it was left.
        mode: what is shown first; "normal" is the picture.
        pose: first camera: a pose copied from the viewer, or x,y,z,x,y,z of eye and target in the grid frame (y up).
    """
    window_size = parse_size(size) if size else None
    if frames is not None and frames < 1:
        raise UserError("draws nothing", where="--frames", expected="1 or more", found=frames)
    if screenshot is not None and frames is None:
        frames = 1
    if pose is not None:
        _check_pose(pose)
    path = pack or demo_pack()
    loaded = load_pack(path) if path is not None else None  # a bad pack is told before any window opens
    start = Start(loaded, path, mode, pose, window_size, frames, screenshot)
    try:
        _show_window(start)
    except NoDisplay as reason:
        print(f"snerg-view: {reason}; rendering an orbit into {OUT}/ instead", file=sys.stderr)
        _render_instead(start)


@dataclass(frozen=True)
class Start:
    """What the command line asks for. size: None means the remembered one."""

    pack: Pack | None
    path: Path | None
    mode: Mode
    pose: str | None
    size: tuple[int, int] | None
    frames: int | None
    screenshot: Path | None

    @property
    def name(self) -> str:
        """What the pack is called."""
        if self.path is None:
            return ""
        if self.path == demo_pack():
            return "demo"
        return name_of(self.path)


def _check_pose(text: str) -> None:
    try:
        pose_from_text(text)
    except ValueError as error:
        raise UserError(str(error), where="--pose") from error


def _show_window(start: Start) -> None:
    """Runs the viewer until it is closed. NoDisplay where there is none."""
    problem = display_problem()
    if problem:
        raise NoDisplay(problem)
    app = App(demo=demo_pack())
    scripted = start.frames is not None  # scripts get the same picture whatever was remembered
    if not scripted:
        app.use(preferences.load(preferences.default_file()))
    app.set(mode=start.mode)
    with Window(app, start.size or app.preferences.window) as window:
        if start.pack is not None and start.path is not None:
            app.show(start.pack, start.path, start.name)
            if start.pose is not None:
                app.paste_pose(start.pose)
        if start.frames is None:
            window.run()
            app.preferences.window = window.size
            problem = preferences.save(app.remembered(), preferences.default_file())
            if problem:
                print(f"snerg-view: {problem}", file=sys.stderr)
            return
        window.draw_frames(start.frames)
        if start.screenshot is not None:
            window.save_screenshot(start.screenshot)
            print(start.screenshot)


def _render_instead(start: Start) -> None:
    if start.screenshot is not None:
        raise UserError("needs a display", where="--screenshot", remedy="start it with xvfb-run, or use snerg-render")
    if start.pack is None:
        raise UserError("there is no pack to render", remedy="name one: snerg-view PACK")
    for written in fly_over(start.pack, start.name, OUT, RenderSettings(mode=start.mode)):
        print(written)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of snerg-view; returns the exit status."""
    return run_command(view, prog="snerg-view", args=args)


if __name__ == "__main__":
    sys.exit(main())
