"""All keys, and what the mouse does, over everything else."""

from __future__ import annotations

from itertools import groupby

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.panels import theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import coloured, font, px

MOUSE = (
    ("Left drag", "turn"),
    ("Right or middle drag", "slide"),
    ("Wheel", "towards the cursor"),
    ("Double click", "turn about this point"),
)
MOUSE_BOUNDED = (("Left or middle drag", "slide"), ("Right drag", "turn a little"), ("Wheel", "nearer, farther"))


def show(app: App, fonts: Fonts) -> None:
    """Draws the overlay while it is wanted; a click beside it closes it."""
    if not app.interface.help_shown:
        return
    size = imgui.get_io().display_size
    imgui.set_next_window_pos(ImVec2(0.5 * size.x, 0.5 * size.y), imgui.Cond_.always, ImVec2(0.5, 0.5))
    imgui.set_next_window_size(ImVec2(min(px(700), size.x - px(32)), 0))
    imgui.set_next_window_focus()
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_nav
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(28), px(24)))
    with coloured(window_bg=theme.PANEL):
        imgui.begin("##help", None, flags | imgui.WindowFlags_.always_auto_resize)
    imgui.pop_style_var()
    with font(fonts.bold, theme.LARGE):
        imgui.text_unformatted("Keys and mouse")
    imgui.dummy(ImVec2(0, px(4)))
    imgui.columns(2, "##columns", False)
    imgui.set_column_width(0, 0.53 * imgui.get_window_width())
    bounded = app.scene is not None and app.scene.rig.bounded
    _heading("Mouse", fonts)
    for keys, title in MOUSE_BOUNDED if bounded else MOUSE:
        _row(keys, title, fonts)
    shown = [command for command in COMMANDS.values() if command.keys]
    groups = [(name, list(group)) for name, group in groupby(shown, lambda command: command.group)]
    for i, (name, commands) in enumerate(groups):
        if i == len(groups) // 2:
            imgui.next_column()
        else:
            imgui.dummy(ImVec2(0, px(4)))
        _heading(name, fonts)
        for command in commands:
            _row(" or ".join(command.keys), command.title, fonts)
    imgui.columns(1)
    if imgui.is_mouse_clicked(0) and not imgui.is_window_hovered(imgui.HoveredFlags_.root_and_child_windows):
        app.interface.help_shown = False
    imgui.end()


def _heading(text: str, fonts: Fonts) -> None:
    with font(fonts.bold, theme.SMALL), coloured(text=theme.ACCENT):
        imgui.text_unformatted(text.upper())


def _row(keys: str, title: str, fonts: Fonts) -> None:
    with coloured(text=theme.MUTED):
        imgui.text_unformatted(title[:1].upper() + title[1:])
    imgui.same_line()
    width = imgui.calc_text_size(keys).x
    room = imgui.get_content_region_avail().x - px(18)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(0.0, room - width))
    imgui.text_unformatted(keys)
