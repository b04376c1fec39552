"""The bar on top: what is open, how fast it is drawn, and what is wanted often."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.commands import run
from viewer.panels import layout, theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import coloured, font, icon_button, px
from viewer.window.canvas import Canvas


def show(app: App, canvas: Canvas, box: layout.Box, fonts: Fonts) -> None:
    """Draws the bar."""
    with coloured(window_bg=theme.BASE):
        layout.begin("##top", box, (12, 8))
    _mark(fonts)
    if app.scene is not None:
        _name(app, fonts)
    buttons = [
        (fa.ICON_FA_FOLDER_OPEN, "open", "Open a pack  (Ctrl+O)", True),
        (fa.ICON_FA_CAMERA, "save", "Save the picture  (Ctrl+S)", True),
        (fa.ICON_FA_HOUSE, "home", "Back to the first view  (R)", True),
        (fa.ICON_FA_EXPAND, "frame", "Show the whole scene  (F)", True),
        (fa.ICON_FA_KEYBOARD, "help", "Keys and mouse  (?)", False),
        (fa.ICON_FA_UP_RIGHT_AND_DOWN_LEFT_FROM_CENTER, "full-screen", "Full screen  (F11)", False),
    ]
    buttons = [button for button in buttons if app.scene is not None or not button[3]]
    width = len(buttons) * px(34) + (len(buttons) - 1) * px(4)
    x = imgui.get_window_width() - px(8) - width
    _speed(app, x - px(14), fonts)
    for i, (icon, command, tooltip, _) in enumerate(buttons):
        imgui.set_cursor_pos(ImVec2(x + i * px(38), px(8)))
        if icon_button(icon, f"top {command}", tooltip):
            run(app, command)
    imgui.end()


def _mark(fonts: Fonts) -> None:
    """The program's mark: a cube of voxels, one of them lit, and its name."""
    at = imgui.get_cursor_screen_pos()
    draw = imgui.get_window_draw_list()
    x, y, s, gap = at.x + px(2), at.y + px(7), px(8), px(2)
    shades = ((theme.ACCENT, 1.0), (theme.ACCENT, 0.45), (theme.ACCENT, 0.25), (theme.ACCENT, 0.7))
    for i, (code, alpha) in enumerate(shades):
        left, top = x + (i % 2) * (s + gap), y + (i // 2) * (s + gap)
        draw.add_rect_filled(ImVec2(left, top), ImVec2(left + s, top + s), theme.packed(code, alpha), px(2))
    imgui.set_cursor_pos(ImVec2(px(42), px(14)))
    with font(fonts.bold, 17.0):
        imgui.text_unformatted("snerg")


def _name(app: App, fonts: Fonts) -> None:
    assert app.scene is not None
    imgui.same_line(0, px(14))
    at = imgui.get_cursor_screen_pos()
    draw = imgui.get_window_draw_list()
    draw.add_line(ImVec2(at.x, at.y + px(1)), ImVec2(at.x, at.y + px(19)), theme.packed(theme.LINE), px(1))
    imgui.same_line(0, px(28))
    imgui.set_cursor_pos_y(px(15))
    imgui.text_unformatted(app.scene.name)
    if imgui.is_item_hovered():
        imgui.set_tooltip(str(app.scene.path))
    imgui.same_line(0, px(10))
    imgui.set_cursor_pos_y(px(16))
    with font(None, theme.SMALL), coloured(text=theme.FAINT if app.scene.whole else theme.WARN):
        imgui.text_unformatted(state_of(app))


def state_of(app: App) -> str:
    """What the pack that is shown consists of, or how far it is read: a preview's voxels are not its own."""
    if app.scene is None:
        return ""
    if not app.scene.whole:
        images = app.loading.images if app.loading is not None else (0, 0)
        return f"loading {images[0]} of {images[1]} images" if images[1] else "loading"
    return " × ".join(str(side) for side in app.scene.pack.grid_size) + " voxels"


def _speed(app: App, right: float, fonts: Fonts) -> None:
    if app.scene is None or not app.times.drawn:
        return
    text = f"{app.times.summary().fps:.0f} fps"
    with font(fonts.bold, theme.SMALL):
        width = imgui.calc_text_size(text).x
        imgui.same_line()
        imgui.set_cursor_pos(ImVec2(right - width, px(16)))
        with coloured(text=theme.ACCENT):
            imgui.text_unformatted(text)
