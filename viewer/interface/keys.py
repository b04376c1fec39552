"""Keys: what they do, and the overlay that lists them.

imgui spreads fast input over several frames, and a text field takes the keyboard a frame after the click that it was
given. A press is therefore only looked at once imgui has taken all events before it from its queue: what is typed right
after a click into a field belongs to the field, however slow the frames are.
"""

from collections import deque
from itertools import groupby

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core import theme
from viewer.core.input import KeyPress, shown_keys
from viewer.core.language import translated
from viewer.core.widgets import coloured, figure, in_front, px, style, write

Presses = deque[tuple[int, KeyPress]]  # not looked at yet: imgui's number of the same event, and the press
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


def dispatch(app: App, waiting: Presses) -> None:
    """Runs the commands that are due. A text field that is being typed into keeps its keys, dialogs keep them all."""
    queue = imgui.get_current_context().input_events_queue
    while waiting and (not len(queue) or waiting[0][0] < queue[0].event_id):
        _, press = waiting.popleft()
        if not imgui.get_io().want_text_input:
            _run(app, press)


def _run(app: App, press: KeyPress) -> None:
    if press.name == "Escape" and not in_front(app) and imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        imgui.internal.close_popup_to_level(0, True)  # a menu or a list: it is what Escape is for
        return
    for command in COMMANDS.values():
        if any(fits(press, key) for key in command.keys) and (command.id == "quit" or not in_front(app)):
            app.run(command.id)
            return


def queue_is_empty() -> bool:
    """Whether imgui has taken in all that was typed, clicked and moved."""
    return not len(imgui.get_current_context().input_events_queue)


# --- All keys, and what the mouse does, over everything else ---

NAME = "##help"
COLUMN = 330.0  # width of a column; as many as the window has space for
MOST_COLUMNS = 3
PADDING = (28.0, 20.0)
SCROLL_PER_S = 600.0  # by the arrow keys
MOUSE = (
    ("Left drag or arrows", "turn"),
    ("Right or middle drag, or with Shift", "slide"),
    ("Wheel", "towards the cursor"),
    ("Double click", "turn about this point"),
)
MOUSE_BOUNDED = (
    ("Left or middle drag, or arrows", "slide"),
    ("Right drag, or Shift + arrows", "turn a little"),
    ("Wheel", "nearer, farther"),
)


_Group = tuple[str, tuple[tuple[str, str], ...]]  # its title; keys and what they do


def _groups(app: App) -> list[_Group]:
    bounded = app.scene is not None and app.scene.rig.bounded
    groups: list[_Group] = [("Mouse and arrow keys", MOUSE_BOUNDED if bounded else MOUSE)]
    if not bounded:
        forward, left, back, right, down, up = app.keyboard.flying_names
        flying = (
            (f"{forward}  {back} or arrows", "forward, back"),
            (f"{left}  {right} or arrows", "left, right"),
            (f"{up}  {down}", "up, down"),
            ("Drag", "look around"),
            ("Shift, or the wheel", "faster"),
        )
        groups += [("While flying", flying), ("While walking", (*flying[:2], (up, "jump"), *flying[3:]))]
    either = f" {translated('or')} "
    commands = [command for command in COMMANDS.values() if command.keys]
    for name, members in groupby(commands, lambda command: command.group):
        groups.append((name, tuple((shown_keys(either.join(member.keys)), member.title) for member in members)))
    return groups


def _columns(groups: list[_Group], count: int) -> list[list[_Group]]:
    """The groups in their order, divided so that the longest column is as short as can be."""
    if count == 1:
        return [groups]
    divided = ([groups[:cut], *_columns(groups[cut:], count - 1)] for cut in range(1, len(groups) - count + 2))
    return min(divided, key=lambda columns: max(sum(len(rows) + 2 for _, rows in column) for column in columns))


def show(app: App) -> None:
    """Draws the overlay while no dialog is there; a click beside it closes it, wheel and arrow keys scroll it."""
    if not app.interface.help_shown or in_front(app):
        return
    size = imgui.get_io().display_size
    most = ImVec2(size.x - px(24), size.y - px(24))
    count = max(1, min(MOST_COLUMNS, int((most.x - 2 * px(PADDING[0])) / px(COLUMN))))
    imgui.set_next_window_pos(ImVec2(0.5 * size.x, 0.5 * size.y), imgui.Cond_.always, ImVec2(0.5, 0.5))
    wide = min(count * px(COLUMN) + 2 * px(PADDING[0]), most.x)
    imgui.set_next_window_size_constraints(ImVec2(wide, 0), ImVec2(wide, most.y))
    imgui.set_next_window_focus()
    kinds = imgui.WindowFlags_
    flags = kinds.no_title_bar | kinds.no_resize | kinds.no_move | kinds.no_collapse | kinds.no_docking
    flags |= kinds.no_saved_settings | kinds.no_nav | kinds.always_auto_resize
    with style(window_padding=PADDING), coloured(window_bg=theme.PANEL):
        imgui.begin(NAME, None, flags)
    write("Keys and mouse", face=theme.fonts.bold, size=theme.LARGE)
    with style(item_spacing=(8, 4), cell_padding=(10, 0)):
        if imgui.begin_table("##columns", count, imgui.TableFlags_.sizing_stretch_same):
            for column in _columns(_groups(app), count):
                imgui.table_next_column()
                for heading, rows in column:
                    _group(heading, rows)
            imgui.end_table()
    scroll = app.keyboard.axis("Down", "Up") * imgui.get_io().delta_time
    if scroll:
        imgui.set_scroll_y(imgui.get_scroll_y() + px(SCROLL_PER_S) * scroll)
        app.touch()
    if imgui.is_mouse_clicked(0) and not imgui.is_window_hovered(imgui.HoveredFlags_.root_and_child_windows):
        app.interface.help_shown = False
    imgui.end()


def _group(heading: str, rows: tuple[tuple[str, str], ...]) -> None:
    imgui.dummy(ImVec2(0, px(1)))
    write(translated(heading).upper(), theme.ACCENT, theme.fonts.bold, theme.SMALL)
    for keys, title in rows:
        title = translated(title)
        figure(title[:1].upper() + title[1:], keys)
