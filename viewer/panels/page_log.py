"""What the program said."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.panels import theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import coloured, font, hint, px

COLOURS = {"info": theme.TEXT, "warning": theme.WARN, "error": theme.BAD}


def show(app: App, canvas: CanvasInterface, fonts: Fonts) -> None:
    """Draws the page, newest line first."""
    lines = list(app.messages.lines)
    if not lines:
        hint("No messages yet.")
        return
    if imgui.button("Copy all", ImVec2(-1, 0)):
        app.clipboard.set("\n".join(f"{line.clock} {line.level}: {line.text}" for line in lines))
    for line in reversed(lines):
        imgui.dummy(ImVec2(0, px(1)))
        with font(fonts.mono, theme.SMALL), coloured(text=theme.FAINT):
            imgui.text_unformatted(line.clock)
        imgui.push_text_wrap_pos(0.0)
        with font(None, theme.SMALL + 1), coloured(text=COLOURS[line.level]):
            imgui.text_unformatted(line.text)
        imgui.pop_text_wrap_pos()
