"""Settings page and log page."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core import theme
from viewer.core.input import GAMEPAD_BUTTONS, MOUSE_BUTTONS
from viewer.core.language import LANGUAGES, LETTERS
from viewer.core.state import SCALES
from viewer.core.theme import THEMES, Fonts
from viewer.core.widgets import card, choice, figure, font, hint, label, paragraph, px, segments, slider, switch, write
from viewer.rendering.canvas import Canvas

STICKS = (
    ("Left stick", "slide; move while flying or walking"),
    ("Right stick", "turn; look"),
    ("Triggers", "away, closer; down, up"),
)
CAP = (("Push", "slide, closer"), ("Tilt, turn", "turn the scene"))


def show(app: App, canvas: Canvas, fonts: Fonts) -> None:
    interface = app.interface
    with card("look", fonts, "Look"):
        label("Theme")
        if picked := segments("theme", THEMES, interface.theme, {name: name.capitalize() for name in THEMES}):
            app.set_theme(picked)
        label("Language")
        if picked := choice("language", list(LANGUAGES), interface.language, LANGUAGES):
            interface.language = picked
        if not fonts.has(LETTERS.get(interface.language, "")):
            hint("No font with these letters is installed. Install one, such as Noto Sans CJK.", theme.WARN)
        label("Interface")
        titles = {str(scale): f"{100 * scale:.0f} %" for scale in (*SCALES, interface.scale)}
        if picked := choice("scale", [str(scale) for scale in SCALES], str(interface.scale), titles):
            interface.scale = float(picked)
        hint("Ctrl+Plus, Ctrl+Minus and Ctrl+0 do the same.")
        interface.axes_shown = switch("axes", interface.axes_shown, "Axes")
    with card("controllers", fonts, "Gamepad and 3D mouse"):
        usable = [state for state in app.controllers.states if state.usable]
        for state in usable:
            figure(state.name, "gamepad" if state.gamepad else "3D mouse")
        if not usable:
            hint("None is connected. Gamepads and SpaceMouse devices are found when they are plugged in.")
        label("Dead zone")
        app.controllers.dead_zone = slider("dead zone", app.controllers.dead_zone, 0.0, 50.0, "%.0f %%", times=100)
        for rows, buttons, shown in (
            (STICKS, GAMEPAD_BUTTONS, any(state.gamepad for state in usable)),
            (CAP, MOUSE_BUTTONS, any(state.mouse for state in usable)),
        ):
            if shown:
                for name, what in rows:
                    figure(name, what)
                for name, command in buttons.values():
                    figure(name.capitalize(), COMMANDS[command].title)


# --- What the program said ---

COLOURS = {"info": theme.TEXT, "warning": theme.WARN, "error": theme.BAD}


def show_log(app: App, canvas: Canvas, fonts: Fonts) -> None:
    lines = list(app.messages.lines)
    if not lines:
        hint("No messages yet.")
        return
    if imgui.button("Copy all", ImVec2(-1, 0)):
        app.clipboard.set("\n".join(f"{line.clock} {line.level}: {line.text}" for line in lines))
    for line in reversed(lines):
        imgui.dummy(ImVec2(0, px(1)))
        write(line.clock, theme.FAINT, fonts.mono, theme.SMALL)
        with font(None, theme.SMALL + 1):
            paragraph(line.text, COLOURS[line.level])
