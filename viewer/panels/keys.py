"""Keys to commands: reads imgui's keyboard, so that a window and a test press them alike."""

from __future__ import annotations

from imgui_bundle import imgui

from viewer.app.application import App
from viewer.app.commands import COMMANDS, run

_NAMES = {
    "Escape": imgui.Key.escape,
    "Space": imgui.Key.space,
    "Tab": imgui.Key.tab,
    "Home": imgui.Key.home,
    "Delete": imgui.Key.delete,
    "Enter": imgui.Key.enter,
    "?": imgui.Key.slash,
    **{f"F{i}": getattr(imgui.Key, f"f{i}") for i in range(1, 13)},
    **{letter.upper(): getattr(imgui.Key, letter) for letter in "abcdefghijklmnopqrstuvwxyz"},
    **{str(i): getattr(imgui.Key, f"_{i}") for i in range(10)},
}


def pressed(combination: str) -> bool:
    """Whether "Ctrl+Shift+Z" and the like was pressed in this frame; held keys do not repeat."""
    *modifiers, name = combination.split("+")
    io = imgui.get_io()
    if name == "?":
        return imgui.is_key_pressed(_NAMES[name], False) and io.key_shift and not io.key_ctrl
    if io.key_ctrl != ("Ctrl" in modifiers) or io.key_shift != ("Shift" in modifiers) or io.key_alt:
        return False
    return imgui.is_key_pressed(_NAMES[name], name in ("Z", "Y"))


def dispatch(app: App) -> None:
    """Runs the commands whose keys were pressed. A text field that is being typed into keeps its keys."""
    if imgui.get_io().want_text_input:
        return
    busy = bool(app.messages.dialogs) or app.file_request is not None or app.making.plan is not None
    for command in COMMANDS.values():
        if busy and command.id != "quit":
            continue
        if any(pressed(key) for key in command.keys):
            run(app, command.id)
