"""Everything that a key, a button or a menu can ask for, by name.

Keys have the names that imgui gives them ("R", "Home", "F11"), with "Ctrl+" (Cmd on macOS) and "Shift+" before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from viewer.app.application import App
from viewer.features.display.display import next_mode
from viewer.features.opening.open_prompt import ask_to_open, browse

STEP_DEGREES = 15.0  # of a key that turns


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


def _escape(app: App) -> None:
    """Closes what lies on top."""
    if app.interface.help_shown:
        app.interface.help_shown = False
    elif app.filming.export is not None:
        app.filming.cancel(app)
    elif app.loading is not None:
        app.cancel_loading()
    elif app.measure_tool.escape(app):
        pass
    elif app.comparison.against == "photograph":
        app.comparison.stop()
    elif app.interface.over:
        app.interface.over = ""
    elif app.interface.full_screen:
        app.interface.full_screen = False


def _orthographic(app: App) -> None:
    if app.scene is not None:
        app.scene.rig.set_orthographic(not app.scene.rig.orthographic)


def _turn(right: float, up: float) -> Callable[[App], object]:
    return _rig(lambda rig: rig.turn(STEP_DEGREES * right, STEP_DEGREES * up))


def _usual_size(app: App) -> None:
    app.interface.scale = 1.0


def _other_theme(app: App) -> None:
    app.set_theme("dark" if app.interface.theme == "light" else "light")


def _views() -> tuple[Command, ...]:
    """The views along the axes, by the number block as in Blender, and by the digits above the letters."""

    def view(id: str, title: str, azimuth: float, elevation: float, *keys: str) -> Command:
        return Command(id, title, "Views", _rig(lambda rig: rig.look_along(azimuth, elevation)), keys)

    return (
        view("front", "Look from the front", 0, 0, "Num1", "1"),
        view("back", "Look from behind", 180, 0, "Ctrl+Num1", "Ctrl+1"),
        view("right", "Look from the right", 90, 0, "Num3", "2"),
        view("left", "Look from the left", 270, 0, "Ctrl+Num3", "Ctrl+2"),
        view("top", "Look from above", 0, 90, "Num7", "3"),
        view("bottom", "Look from below", 0, -90, "Ctrl+Num7", "Ctrl+3"),
    )


COMMANDS: dict[str, Command] = {
    command.id: command
    for command in (
        Command("home", "Back to the first view", "Camera", _rig(lambda rig: rig.home()), ("Home", "R")),
        Command("frame", "Show the whole scene", "Camera", _rig(lambda rig: rig.frame()), ("F",)),
        Command("fly", "Fly or orbit", "Camera", _fly, ("V",)),
        Command("copy-pose", "Copy the pose as text", "Camera", lambda app: app.copy_pose(), ("Ctrl+C",)),
        Command(
            "paste", "Go to a copied pose, open a copied path", "Camera", lambda app: app.paste(), ("Ctrl+V",), False
        ),
        Command("undo", "Undo", "Camera", _rig(lambda rig: rig.history.undo()), ("Ctrl+Z",)),
        Command("redo", "Redo it", "Camera", _rig(lambda rig: rig.history.redo()), ("Ctrl+Shift+Z", "Ctrl+Y")),
        *_views(),
        Command("orthographic", "Orthographic or perspective", "Views", _orthographic, ("Num5", "5")),
        Command("opposite", "Look from the other side", "Views", _rig(lambda rig: rig.turn(180, 0)), ("Num9",)),
        Command("turn-left", "Turn by 15° to the left", "Views", _turn(-1, 0), ("Num4",)),
        Command("turn-right", "Turn by 15° to the right", "Views", _turn(1, 0), ("Num6",)),
        Command("turn-up", "Turn by 15° upwards", "Views", _turn(0, 1), ("Num8",)),
        Command("turn-down", "Turn by 15° downwards", "Views", _turn(0, -1), ("Num2",)),
        Command("next-mode", "Next display mode", "Picture", lambda app: next_mode(app, 1), ("Space",)),
        Command("last-mode", "Previous display mode", "Picture", lambda app: next_mode(app, -1), ("Shift+Space",)),
        Command("next-photo", "Next photograph", "Picture", lambda app: app.gallery.step(app, 1), ("N",)),
        Command("last-photo", "Previous photograph", "Picture", lambda app: app.gallery.step(app, -1), ("B",)),
        Command("save", "Save the picture", "Picture", lambda app: app.filming.ask_for_still(app), ("Ctrl+S",)),
        Command("copy-picture", "Copy the picture", "Picture", lambda app: app.filming.copy(app), ("Ctrl+I",)),
        Command("export-scene", "Export the scene", "Picture", lambda app: app.exporting.ask(app), ("Ctrl+E",)),
        Command("measure", "Measure", "Ruler", lambda app: app.measure_tool.toggle(app), ("M",)),
        Command("finish-line", "End the line", "Ruler", lambda app: app.measure_tool.finish(app), ("Enter",)),
        Command(
            "remove-point",
            "Remove the last point",
            "Ruler",
            lambda app: app.measure_tool.back(app),
            ("Backspace", "Delete"),
        ),
        Command(
            "copy-measurements",
            "Copy the measurements",
            "Ruler",
            lambda app: app.measure_tool.copy(app),
            ("Ctrl+Shift+C",),
        ),
        Command("bookmark", "Bookmark this view", "Bookmarks", lambda app: app.bookmarks.add(app), ("Ctrl+D",)),
        Command("next-bookmark", "Next bookmark", "Bookmarks", lambda app: app.bookmarks.step(app, 1), ("PageDown",)),
        Command(
            "last-bookmark", "Previous bookmark", "Bookmarks", lambda app: app.bookmarks.step(app, -1), ("PageUp",)
        ),
        Command("keyframe", "Add a keyframe", "Film", lambda app: app.filming.add(app), ("K",)),
        Command("play", "Play the path", "Film", lambda app: app.filming.play(app), ("P",)),
        Command("turntable", "Make a turntable", "Film", lambda app: app.filming.turntable(app), ("T",)),
        Command("open", "Open", "Window", ask_to_open, ("Ctrl+O",), False),
        Command("open-folder", "Open a folder", "Window", lambda app: browse(app, "folder"), ("Ctrl+Shift+O",), False),
        Command("next-pack", "Next open pack", "Window", lambda app: app.open_packs.switch(app, 1), ("Ctrl+Tab",)),
        Command(
            "last-pack", "Previous open pack", "Window", lambda app: app.open_packs.switch(app, -1), ("Ctrl+Shift+Tab",)
        ),
        Command(
            "make",
            "Make a scene from photographs",
            "Window",
            lambda app: app.making.ask_for_photographs(app),
            ("Ctrl+M",),
            False,
        ),
        Command("close", "Close the scene", "Window", lambda app: app.close(), ("Ctrl+W",)),
        Command("panels", "Show or hide the panels", "Window", _toggle("panels_shown"), ("Tab",), False),
        Command("layout", "Reset the layout", "Window", lambda app: app.interface.reset_layout(), ("Ctrl+L",), False),
        Command("larger", "Larger interface", "Window", lambda app: app.interface.rescale(1), ("Ctrl+Plus",), False),
        Command(
            "smaller", "Smaller interface", "Window", lambda app: app.interface.rescale(-1), ("Ctrl+Minus",), False
        ),
        Command("usual-size", "Interface at its usual size", "Window", _usual_size, ("Ctrl+0",), False),
        Command("theme", "Light or dark theme", "Window", _other_theme, ("Ctrl+Shift+L",), False),
        Command("full-screen", "Full screen", "Window", _toggle("full_screen"), ("F11",), False),
        Command("help", "Keys and mouse", "Window", _toggle("help_shown"), ("?", "F1"), False),
        Command("escape", "Close the top dialog", "Window", _escape, ("Escape",), False),
        Command("quit", "Quit", "Window", lambda app: app.making.ask_to_quit(app), ("Ctrl+Q",), False),
        Command(
            "save-session",
            "Save the session",
            "Window",
            lambda app: app.sessions.ask_where_to_save(app),
            ("Ctrl+Shift+S",),
        ),
        Command(
            "last-session",
            "Continue the last session",
            "Window",
            lambda app: app.sessions.open_last(app),
            needs_scene=False,
        ),
        Command("save-measurements", "Save the measurements", "Ruler", lambda app: app.measure_tool.ask_for_table(app)),
        Command("film-bookmarks", "Film through the bookmarks", "Bookmarks", lambda app: app.bookmarks.film(app)),
        Command("set-scale", "Set the scale", "Ruler", lambda app: app.measure_tool.set_scale(app)),
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
    app.messages.crash_log(f"command {name}")
    try:
        command.action(app)
    except Exception as error:  # the program goes on
        app.messages.fail(f"“{command.title}” failed", error)
    app.touch()
    return True
