"""Everything that a key, a button or a menu can ask for, by name.

Keys have the names that imgui gives them ("R", "Home", "F11"), with "Ctrl+" (Cmd on macOS) and "Shift+" before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scenepack.placement import NOT_MOVED
from viewer.features.display.display import next_mode
from viewer.features.editing.erasing import CHANGES, RULES, TOOLS
from viewer.features.editing.erasing import PAGE as ERASE_PAGE
from viewer.features.film.filming import KIOSK_COMMANDS
from viewer.features.opening.opening import ask_to_open, browse
from viewer.features.placing import placing

if TYPE_CHECKING:
    from viewer.app.application import App


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
        if app.kiosk is not None and self.id not in KIOSK_COMMANDS:
            return False
        return app.scene is not None or not self.needs_scene


def _rig(action: Callable) -> Callable[[App], object]:
    return lambda app: action(app.open_scene.rig)


def _toggle(name: str) -> Callable[[App], object]:
    return lambda app: setattr(app.interface, name, not getattr(app.interface, name))


def _fly(app: App) -> None:
    rig = app.open_scene.rig
    if not rig.bounded:
        rig.take_over()
        rig.navigate("orbit" if rig.flying else "fly")
        *move, down, up = app.keyboard.flying_names
        flying = f"Flying: {' '.join(move)}, {down} and {up}, or the arrows; drag to look"
        app.messages.say(flying if rig.flying else "Orbiting the pivot")


def _escape(app: App) -> None:
    if app.interface.help_shown:
        app.interface.help_shown = False
    elif app.filming.export is not None:
        app.filming.cancel(app)
    elif app.loading is not None:
        app.opening.cancel(app)
    elif app.measure_tool.escape(app) or app.erasing.escape(app):
        pass
    elif app.comparison.against == "photograph":
        app.comparison.stop()
    elif app.interface.over:
        app.interface.over = ""
    elif app.interface.full_screen:
        app.interface.full_screen = False


def _close(app: App) -> None:
    if not app.erasing.ask_to_leave(app, [app.open_scene], "close-unsaved"):
        app.close()


def _quit(app: App) -> None:
    shown = [app.scene] if app.scene else []
    if not app.erasing.ask_to_leave(app, [*shown, *app.open_packs.packs], "quit-unsaved"):
        app.making.ask_to_quit(app)


def _remove(app: App) -> None:
    erasing = app.erasing.tool or app.interface.shows(ERASE_PAGE)
    if not (erasing and app.erasing.erase(app)):
        app.measure_tool.back(app)


def _other_theme(app: App) -> None:
    app.set_theme("dark" if app.interface.theme == "light" else "light")


def _usual_size(app: App) -> None:
    app.interface.scale = 1.0


_other_projection = _rig(lambda rig: rig.set_orthographic(not rig.orthographic))


def _tool(feature: str, tool: str) -> Callable[[App], object]:
    def choose(app: App) -> None:
        tools = getattr(app, feature)
        tools.choose(app, "" if tool == tools.tool else tool)

    return choose


# By group: id, title, action, keys with " or " between them, and False for those that need no scene.
_GROUPS: dict[str, tuple[tuple, ...]] = {
    "Camera": (
        ("home", "Back to the first view", _rig(lambda rig: rig.home()), "Home or R"),
        ("frame", "Show the whole scene", _rig(lambda rig: rig.frame()), "F"),
        ("fly", "Fly or orbit", _fly, "V"),
        ("walk", "Walk or orbit", lambda app: app.walking.toggle(app), "G"),
        (
            "copy-pose",
            "Copy the pose as text",
            lambda app: app.copy(app.pose_text(), "The pose is on the clipboard"),
            "Ctrl+C",
        ),
        ("paste", "Go to a copied pose, open a copied path", lambda app: app.paste(), "Ctrl+V", False),
        ("undo", "Undo", _rig(lambda rig: rig.history.undo()), "Ctrl+Z"),
        ("redo", "Redo it", _rig(lambda rig: rig.history.redo()), "Ctrl+Shift+Z or Ctrl+Y"),
    ),
    "Views": (  # along the axes by the number block as in Blender, and by the digits above the letters
        ("front", "Look from the front", _rig(lambda rig: rig.look_along(0, 0)), "Num1 or 1"),
        ("back", "Look from behind", _rig(lambda rig: rig.look_along(180, 0)), "Ctrl+Num1 or Ctrl+1"),
        ("right", "Look from the right", _rig(lambda rig: rig.look_along(90, 0)), "Num3 or 2"),
        ("left", "Look from the left", _rig(lambda rig: rig.look_along(270, 0)), "Ctrl+Num3 or Ctrl+2"),
        ("top", "Look from above", _rig(lambda rig: rig.look_along(0, 90)), "Num7 or 3"),
        ("bottom", "Look from below", _rig(lambda rig: rig.look_along(0, -90)), "Ctrl+Num7 or Ctrl+3"),
        ("orthographic", "Orthographic or perspective", _other_projection, "Num5 or 5"),
        ("opposite", "Look from the other side", _rig(lambda rig: rig.turn(180, 0)), "Num9"),
        ("turn-left", "Turn by 15° to the left", _rig(lambda rig: rig.turn(-15, 0)), "Num4"),
        ("turn-right", "Turn by 15° to the right", _rig(lambda rig: rig.turn(15, 0)), "Num6"),
        ("turn-up", "Turn by 15° upwards", _rig(lambda rig: rig.turn(0, 15)), "Num8"),
        ("turn-down", "Turn by 15° downwards", _rig(lambda rig: rig.turn(0, -15)), "Num2"),
    ),
    "Picture": (
        ("next-mode", "Next display mode", lambda app: next_mode(app, 1), "Space"),
        ("last-mode", "Previous display mode", lambda app: next_mode(app, -1), "Shift+Space"),
        ("next-photo", "Next photograph", lambda app: app.gallery.step(app, 1), "N"),
        ("last-photo", "Previous photograph", lambda app: app.gallery.step(app, -1), "B"),
        ("save", "Save the picture", lambda app: app.filming.ask_for_still(app), "Ctrl+S"),
        ("copy-picture", "Copy the picture", lambda app: app.filming.copy(app), "Ctrl+I"),
        ("export-scene", "Export the scene", lambda app: app.exporting.ask(app), "Ctrl+E"),
        ("share", "Share the scene", lambda app: app.sharing.start(app), ""),
    ),
    "Ruler": (
        ("measure", "Measure", lambda app: app.measure_tool.toggle(app), "M"),
        ("finish-line", "End the line", lambda app: app.measure_tool.finish(app), "Enter"),
        ("remove-point", "Remove the point or selection", _remove, "Backspace or Delete"),
        ("copy-measurements", "Copy the measurements", lambda app: app.measure_tool.copy(app), "Ctrl+Shift+C"),
    ),
    "Erasing": (("erase", "Erase parts of the scene", lambda app: app.erasing.toggle(app), "X"),),
    "Bookmarks": (
        ("bookmark", "Bookmark this view", lambda app: app.bookmarks.add(app), "Ctrl+D"),
        ("annotate", "Annotate a place", lambda app: app.bookmarks.annotate(app), "Ctrl+Shift+D"),
        ("next-bookmark", "Next bookmark", lambda app: app.bookmarks.step(app, 1), "PageDown"),
        ("last-bookmark", "Previous bookmark", lambda app: app.bookmarks.step(app, -1), "PageUp"),
    ),
    "Film": (
        ("keyframe", "Add a keyframe", lambda app: app.filming.add(app), "K"),
        ("play", "Play the path", lambda app: app.filming.play(app), "P"),
        ("turntable", "Make a turntable", lambda app: app.filming.turntable(app), "T"),
    ),
    "Window": (
        ("open", "Open", ask_to_open, "Ctrl+O", False),
        ("open-folder", "Open a folder", lambda app: browse(app, "folder"), "Ctrl+Shift+O", False),
        ("next-pack", "Next open pack", lambda app: app.open_packs.switch(app, 1), "Ctrl+Tab"),
        ("last-pack", "Previous open pack", lambda app: app.open_packs.switch(app, -1), "Ctrl+Shift+Tab"),
        ("make", "Make a scene from photographs", lambda app: app.making.ask_for_photographs(app), "Ctrl+M", False),
        ("close", "Close the scene", _close, "Ctrl+W"),
        ("panels", "Show or hide the panels", _toggle("panels_shown"), "Tab", False),
        ("layout", "Reset the layout", lambda app: app.interface.reset_layout(), "Ctrl+L", False),
        ("larger", "Larger interface", lambda app: app.interface.rescale(1), "Ctrl+Plus", False),
        ("smaller", "Smaller interface", lambda app: app.interface.rescale(-1), "Ctrl+Minus", False),
        ("usual-size", "Interface at its usual size", _usual_size, "Ctrl+0", False),
        ("theme", "Light or dark theme", _other_theme, "Ctrl+Shift+L", False),
        ("full-screen", "Full screen", _toggle("full_screen"), "F11", False),
        ("help", "Keys and mouse", _toggle("help_shown"), "? or F1", False),
        ("escape", "Close the top dialog", _escape, "Escape", False),
        ("quit", "Quit", _quit, "Ctrl+Q", False),
        ("save-session", "Save the session", lambda app: app.sessions.ask_where_to_save(app), "Ctrl+Shift+S"),
        ("last-session", "Continue the last session", lambda app: app.sessions.open_last(app), "", False),
        # answers to dialogs
        ("make-again", "Make it again", lambda app: app.making.again(), "", False),
        ("stop-and-quit", "Stop and quit", lambda app: app.making.stop_and_quit(app), "", False),
        ("close-unsaved", "Close without saving", lambda app: app.close(), ""),
        ("quit-unsaved", "Quit without saving", lambda app: app.making.ask_to_quit(app), "", False),
    ),
    "Buttons": (
        ("save-measurements", "Save the measurements", lambda app: app.measure_tool.ask_for_table(app), ""),
        ("set-scale", "Set the scale", lambda app: app.measure_tool.set_scale(app), ""),
        *((f"erase-{tool}", title, _tool("erasing", tool), "") for tool, title in TOOLS.items()),
        *((f"select-{a}", title, lambda app, a=a: app.erasing.select(app, a), "") for a, title in RULES.items()),
        *((f"selection-{a}", way[0], lambda app, a=a: app.erasing.change(app, a), "") for a, way in CHANGES.items()),
        ("erase-selected", "Erase what is selected", lambda app: app.erasing.erase(app), ""),
        ("save-edited", "Save the edited scene", lambda app: app.erasing.ask_where_to_save(app), ""),
        ("move-ground", "Level the ground by three points", _tool("measure_tool", "ground"), ""),
        ("move-origin", "Set the origin", _tool("measure_tool", "origin"), ""),
        ("move-find-ground", "Find the ground", placing.find_ground, ""),
        ("move-reset", "Back to the grid frame", lambda app: placing.change(app, NOT_MOVED), ""),
        ("film-bookmarks", "Film through the bookmarks", lambda app: app.bookmarks.film(app), ""),
    ),
}
COMMANDS = {
    id: Command(id, title, group, action, tuple(keys.split(" or ")) if keys else (), *needs_scene)
    for group, rows in _GROUPS.items()
    for id, title, action, keys, *needs_scene in rows
}
