"""Keys to commands. Each press carries its own modifiers, and waits until imgui has come to the same event.

imgui spreads fast input over several frames, and a text field takes the keyboard a frame after the click that it was
given. A press is therefore only looked at once imgui has taken all events before it from its queue: what is typed right
after a click into a field belongs to the field, however slow the frames are.
"""

from __future__ import annotations

from collections import deque

from imgui_bundle import imgui

from viewer.app.application import App
from viewer.app.commands import COMMANDS, run
from viewer.app.keyboard import KeyPress
from viewer.panels.modal import in_front

REPEATING = ("Z", "Y", "Num2", "Num4", "Num6", "Num8")  # undo, redo and turning go on while they are held


def fits(press: KeyPress, combination: str) -> bool:
    """Whether a press is "Ctrl+Shift+Z" and the like; "?" is a character, wherever the layout has it."""
    *modifiers, name = combination.split("+")
    if not name.isalnum():
        return press.character == name
    wanted = ("Ctrl" in modifiers, "Shift" in modifiers, False)
    if press.name != name or (press.ctrl, press.shift, press.alt) != wanted:
        return False
    return not press.repeat or name in REPEATING


class Presses:
    """What was pressed and not looked at yet, in one imgui context."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, KeyPress]] = deque()  # imgui's number of the same event, and the press

    def add(self, press: KeyPress) -> None:
        """Call just before imgui is told of the same event; its context must be current."""
        self._waiting.append((imgui.get_current_context().input_events_next_event_id, press))

    def dispatch(self, app: App) -> None:
        """Runs the commands that are due. A text field that is being typed into keeps its keys, dialogs keep them all."""
        queue = imgui.get_current_context().input_events_queue
        while self._waiting and (not len(queue) or self._waiting[0][0] < queue[0].event_id):
            _, press = self._waiting.popleft()
            if not imgui.get_io().want_text_input:
                _run(app, press)


def busy(app: App) -> bool:
    """Whether something waits for an answer, so that keys are not the picture's."""
    return in_front(app) != ""


def _run(app: App, press: KeyPress) -> None:
    for command in COMMANDS.values():
        if any(fits(press, key) for key in command.keys) and (command.id == "quit" or not busy(app)):
            run(app, command.id)
            return


def queue_is_empty() -> bool:
    """Whether imgui has taken in all that was typed, clicked and moved."""
    return not len(imgui.get_current_context().input_events_queue)
