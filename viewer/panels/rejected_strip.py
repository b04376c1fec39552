"""Photographs that are left out, as small pictures in a row, with the reason where the mouse rests."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from viewer.app.canvas_interface import CanvasInterface
from viewer.app.rejected_photographs import RejectedPhotographs
from viewer.panels import theme
from viewer.panels.widgets import hint, px

HEIGHT, GAP, BAR, ROUNDING = 52.0, 5.0, 12.0, 4.0
NAMED = 3
IMAGE = "left out"


def show(canvas: CanvasInterface, rejected: RejectedPhotographs) -> None:
    """Draws a line that counts and names them, and the row."""
    names = list(rejected.why)
    count = "1 photograph is left out" if len(names) == 1 else f"{len(names)} photographs are left out"
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    told = ", ".join(f"{name} ({rejected.why[name]})" for name in names[:NAMED])
    hint(f"{count}: {told}{more}.", theme.WARN)
    if rejected.sheet is None:
        return
    texture = imgui.ImTextureRef(canvas.image(IMAGE, rejected.sheet))
    flags = imgui.WindowFlags_.horizontal_scrollbar | imgui.WindowFlags_.no_background
    imgui.begin_child("##left out", ImVec2(0, px(HEIGHT + BAR)), 0, flags)
    wheel = imgui.get_io().mouse_wheel
    if wheel and imgui.is_window_hovered():
        imgui.set_scroll_x(imgui.get_scroll_x() - px(60) * wheel)
    rows, columns = rejected.sheet.shape[:2]
    for name, (x, y, width, height) in rejected.boxes.items():
        at, wide, high = imgui.get_cursor_screen_pos(), px(HEIGHT) * width / height, px(HEIGHT)
        uv = ImVec2(x / columns, y / rows), ImVec2((x + width) / columns, (y + height) / rows)
        low = ImVec2(at.x + wide, at.y + high)
        imgui.get_window_draw_list().add_image_rounded(texture, at, low, *uv, theme.packed("#ffffff"), px(ROUNDING))
        imgui.dummy(ImVec2(wide, high))
        if imgui.is_item_hovered():
            imgui.set_tooltip(f"{name}\n{rejected.why[name]}")
        imgui.same_line(0, px(GAP))
    imgui.end_child()
