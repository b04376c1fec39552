"""Everything that a key, a button or a menu can ask for, by name.

Keys are told as imgui names them ("R", "Home", "F11"), with "Ctrl+" (Cmd on macOS) and "Shift+" before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from viewer.app.application import App
from viewer.app.files import FileRequest, pack_in
from viewer.rendering.settings import MODES


@dataclass(frozen=True)
class Command:
    """id: what panels and tests call it by. group: a heading of the shortcuts overlay. keys: any of them will do."""

    id: str
    title: str
    group: str
    action: Callable[[App], object]
    keys: tuple[str, ...] = ()
    needs_scene: bool = True

    def enabled(self, app: App) -> bool:
        return app.scene is not None or not self.needs_scene


def _rig(action: Callable) -> Callable[[App], object]:
    return lambda app: action(app.scene.rig) if app.scene is not None else None


def _next_mode(app: App, step: int) -> None:
    modes = modes_for(app)
    now = modes.index(app.settings.mode) if app.settings.mode in modes else 0
    app.set(mode=modes[(now + step) % len(modes)])


def modes_for(app: App) -> tuple[str, ...]:
    """Display modes that show something for the pack that is open."""
    if app.scene is not None and app.scene.pack.view_mlp is None:
        return tuple(mode for mode in MODES if mode not in ("features", "view-dependent"))
    return MODES


def _toggle(name: str) -> Callable[[App], object]:
    def toggle(app: App) -> None:
        setattr(app.interface, name, not getattr(app.interface, name))

    return toggle


def _fly(app: App) -> None:
    if app.scene is not None and not app.scene.rig.bounded:
        rig = app.scene.rig
        rig.take_over()
        rig.flying = not rig.flying
        *move, down, up = app.keyboard.flying_names
        flying = f"Flying: {' '.join(move)}, {down} and {up}, or the arrows; drag to look"
        app.messages.say(flying if rig.flying else "Orbiting the pivot")


def ask_to_open(app: App, kind: Literal["open", "folder"] = "open", *, other: bool = False) -> None:
    """Asks for a pack: a .zip, or a folder."""

    def then(path: Path) -> None:
        app.open(pack_in(path), other=True) if other else app.drop([path])

    title = "Compare with a pack" if other else "Open a pack"
    app.file_request = FileRequest(title, kind, then, (".zip",) if kind == "open" else ())


def ask_to_make(app: App) -> None:
    """Asks for photographs, or for a run."""
    app.file_request = FileRequest("A scene's photographs, or a training run", "folder", lambda path: app.drop([path]))


def ask_for_still(app: App) -> None:
    """Asks where to save the present view."""
    name = f"{app.scene.name}.png" if app.scene is not None else "picture.png"
    app.file_request = FileRequest(
        "Save the picture", "save", lambda path: app.filming.still(app, path), (".png",), name
    )


def _escape(app: App) -> None:
    """Closes what lies on top."""
    if app.interface.help_shown:
        app.interface.help_shown = False
    elif app.making.plan is not None:
        app.making.dismiss(app)
    elif app.filming.export is not None:
        app.filming.cancel(app)
    elif app.loading is not None:
        app.cancel_loading()
    elif app.comparison.against == "photograph":
        app.comparison.stop()
    elif app.interface.over:
        app.interface.over = ""
    elif app.interface.full_screen:
        app.interface.full_screen = False


COMMANDS: dict[str, Command] = {
    command.id: command
    for command in (
        Command("home", "Back to the first view", "Camera", _rig(lambda rig: rig.home()), ("Home", "R")),
        Command("frame", "Show the whole scene", "Camera", _rig(lambda rig: rig.frame()), ("F",)),
        Command("front", "Look from the front", "Camera", _rig(lambda rig: rig.look_along(0, 0)), ("1",)),
        Command("right", "Look from the right", "Camera", _rig(lambda rig: rig.look_along(90, 0)), ("2",)),
        Command("top", "Look from above", "Camera", _rig(lambda rig: rig.look_along(0, 90)), ("3",)),
        Command("fly", "Fly or orbit", "Camera", _fly, ("V",)),
        Command("copy-pose", "Copy the pose as text", "Camera", lambda app: app.copy_pose(), ("Ctrl+C",)),
        Command("paste-pose", "Go to a copied pose", "Camera", lambda app: app.paste_pose(), ("Ctrl+V",)),
        Command("undo", "Undo", "Camera", _rig(lambda rig: rig.history.undo()), ("Ctrl+Z",)),
        Command("redo", "Redo it", "Camera", _rig(lambda rig: rig.history.redo()), ("Ctrl+Shift+Z", "Ctrl+Y")),
        Command("next-mode", "Next display mode", "Picture", lambda app: _next_mode(app, 1), ("Space",)),
        Command("last-mode", "Previous display mode", "Picture", lambda app: _next_mode(app, -1), ("Shift+Space",)),
        Command("next-photo", "Next photograph", "Picture", lambda app: app.gallery.step(app, 1), ("N",)),
        Command("last-photo", "Previous photograph", "Picture", lambda app: app.gallery.step(app, -1), ("B",)),
        Command("save", "Save the picture", "Picture", ask_for_still, ("Ctrl+S",)),
        Command("keyframe", "Add a keyframe", "Film", lambda app: app.filming.add(app), ("K",)),
        Command("play", "Play the path", "Film", lambda app: app.filming.play(app), ("P",)),
        Command("turntable", "Make a turntable", "Film", lambda app: app.filming.turntable(app), ("T",)),
        Command("open", "Open a pack (.zip)", "Window", ask_to_open, ("Ctrl+O",), False),
        Command(
            "open-folder",
            "Open a pack's folder",
            "Window",
            lambda app: ask_to_open(app, "folder"),
            ("Ctrl+Shift+O",),
            False,
        ),
        Command("make", "Make a scene from photographs", "Window", ask_to_make, ("Ctrl+M",), False),
        Command("close", "Close the scene", "Window", lambda app: app.close(), ("Ctrl+W",)),
        Command("panels", "Show or hide the panels", "Window", _toggle("panels_shown"), ("Tab",), False),
        Command("layout", "Reset the layout", "Window", lambda app: app.interface.reset_layout(), ("Ctrl+L",), False),
        Command("full-screen", "Full screen", "Window", _toggle("full_screen"), ("F11",), False),
        Command("help", "Keys and mouse", "Window", _toggle("help_shown"), ("?", "F1"), False),
        Command("escape", "Close the top dialog", "Window", _escape, ("Escape",), False),
        Command("quit", "Quit", "Window", lambda app: app.making.ask_to_quit(app), ("Ctrl+Q",), False),
        # answers to dialogs; no keys
        Command("make-again", "Make it again", "Window", lambda app: app.making.again(app), (), False),
        Command("stop-and-quit", "Stop and quit", "Window", lambda app: app.making.stop_and_quit(app), (), False),
    )
}


def run(app: App, name: str) -> bool:
    """Runs a command by its id; False where it is not to be had now. A failure becomes a dialog."""
    command = COMMANDS[name]
    if not command.enabled(app):
        return False
    try:
        command.action(app)
    except Exception as error:  # the program goes on
        app.messages.fail(f"“{command.title}” failed", error)
    app.touch()
    return True
