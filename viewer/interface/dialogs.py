"""Failures in plain words, one at a time, in the middle of the window."""

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core.widgets import begin_modal, confirmed, heading, main_button, paragraph, pressed_here, px
from viewer.features.making.panel import show_rejected
from viewer.rendering.canvas import Canvas

NAME = "##dialog"


def show(app: App, canvas: Canvas) -> None:
    """Draws the oldest dialog that is not answered; Enter and Escape answer it with its first button."""
    if not app.messages.dialogs:
        return
    dialog = app.messages.dialogs[0]
    if not begin_modal(NAME, 480, 0.45, padding=(24, 22)):
        return
    icon = fa.ICON_FA_TRIANGLE_EXCLAMATION if dialog.failed else fa.ICON_FA_CIRCLE_INFO
    heading(icon, dialog.title, theme.WARN if dialog.failed else theme.ACCENT, 18.0)
    imgui.dummy(ImVec2(0, px(2)))
    paragraph(dialog.text, theme.MUTED)
    if dialog.rejected is not None:
        imgui.dummy(ImVec2(0, px(2)))
        show_rejected(app, canvas, dialog.rejected)
    imgui.dummy(ImVec2(0, px(6)))
    answer = _buttons(dialog.buttons)
    if answer is None and pressed_here(imgui.Key.escape):
        answer = ""
    elif answer is None and confirmed():
        answer = dialog.buttons[0][1]
    if answer is not None:
        app.messages.dialogs.pop(0)
        imgui.close_current_popup()
        if answer:
            app.run(answer)
    imgui.end_popup()


def _buttons(buttons: tuple[tuple[str, str], ...]) -> str | None:
    """Draws them from the right; the command id of the one that was pressed, "" for none to run."""
    width, answer = px(104), None
    imgui.set_cursor_pos_x(imgui.get_window_width() - px(24) - len(buttons) * (width + px(8)) + px(8))
    for i, (text, command) in enumerate(reversed(buttons)):
        if i:
            imgui.same_line()
        last = i == len(buttons) - 1
        if main_button(text, width) if last else imgui.button(text, ImVec2(width, px(34))):
            answer = command
    return answer
