"""Settings page and log page."""

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.input import GAMEPAD_BUTTONS, MOUSE_BUTTONS
from viewer.core.language import LANGUAGES, LETTERS
from viewer.core.state import SCALES
from viewer.core.theme import THEMES
from viewer.core.widgets import px
from viewer.rendering.canvas import Canvas

STICKS = (
    ("Left stick", "slide; move while flying or walking"),
    ("Right stick", "turn; look"),
    ("Triggers", "away, closer; down, up"),
)
CAP = (("Push", "slide, closer"), ("Tilt, turn", "turn the scene"))


def show(app: App, canvas: Canvas) -> None:
    interface = app.interface
    with ui.card("look", "Look"):
        if picked := ui.segments("Theme", {name: name.capitalize() for name in THEMES}, interface.theme):
            app.set_theme(picked)
        if picked := ui.choice("Language", LANGUAGES, LANGUAGES.get(interface.language, interface.language)):
            interface.language = picked
        if not theme.fonts.has(LETTERS.get(interface.language, "")):
            ui.hint("No font with these letters is installed. Install one, such as Noto Sans CJK.", theme.WARN)
        titles = {scale: f"{100 * scale:.0f} %" for scale in SCALES}
        if picked := ui.choice("Interface", titles, f"{100 * interface.scale:.0f} %"):
            interface.scale = picked
        ui.hint("Ctrl+Plus, Ctrl+Minus and Ctrl+0 do the same.")
        interface.axes_shown = ui.switch("axes", interface.axes_shown, "Axes")
    with ui.card("controllers", "Gamepad and 3D mouse"):
        usable = [state for state in app.controllers.states if state.usable]
        for state in usable:
            ui.figure(state.name, "gamepad" if state.gamepad else "3D mouse")
        if not usable:
            ui.hint("None is connected. Gamepads and SpaceMouse devices are found when they are plugged in.")
        app.controllers.dead_zone = ui.slider("Dead zone", app.controllers.dead_zone, 0.0, 50.0, "%.0f %%", times=100)
        for rows, buttons, shown in (
            (STICKS, GAMEPAD_BUTTONS, any(state.gamepad for state in usable)),
            (CAP, MOUSE_BUTTONS, any(state.mouse for state in usable)),
        ):
            if shown:
                for name, what in rows:
                    ui.figure(name, what)
                for name, command in buttons.values():
                    ui.figure(name.capitalize(), COMMANDS[command].title)


# --- What the program said ---

COLOURS = {"info": theme.TEXT, "warning": theme.WARN, "error": theme.BAD}


def show_log(app: App, canvas: Canvas) -> None:
    lines = list(app.messages.lines)
    if not lines:
        ui.hint("No messages yet.")
        return
    if ui.button("Copy all"):
        app.clipboard.text = "\n".join(f"{line.clock} {line.level}: {line.text}" for line in lines)
    for line in reversed(lines):
        imgui.dummy(ImVec2(0, px(1)))
        ui.write(line.clock, theme.FAINT, theme.fonts.mono, theme.SMALL)
        with ui.font(None, theme.SMALL + 1):
            ui.paragraph(line.text, COLOURS[line.level])
