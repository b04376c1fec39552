"""Strips of small pictures: photographs before a scene is made of them, and rejected ones."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from console.progress import duration
from viewer.core import theme
from viewer.core.widgets import hint, px
from viewer.features.making.make_job import RejectedPhotographs
from viewer.features.making.survey import BarePreview
from viewer.rendering.canvas import Canvas

HEIGHT, GAP, ROUNDING, BAR = 64.0, 5.0, 4.0, 12.0
NAMED = 3  # pictures that are set aside, by name
FADED = 0.28  # of the opacity, of a picture that is set aside


def show_preview(canvas: Canvas, preview: BarePreview) -> None:
    """Draws the strip, and under it what is known."""
    imgui.dummy(ImVec2(0, px(2)))
    flags = imgui.WindowFlags_.horizontal_scrollbar | imgui.WindowFlags_.no_background
    imgui.begin_child("##strip", ImVec2(0, px(HEIGHT + BAR)), 0, flags)
    _pictures(canvas, preview)
    imgui.end_child()
    for text, colour in _status_lines(preview):
        hint(text, colour)


def _pictures(canvas: Canvas, preview: BarePreview) -> None:
    draw, texture = imgui.get_window_draw_list(), imgui.ImTextureRef(canvas.sheet(preview))
    rows, columns = preview.sheet.shape[:2]
    wheel = imgui.get_io().mouse_wheel
    if wheel and imgui.is_window_hovered():
        imgui.set_scroll_x(imgui.get_scroll_x() - px(60) * wheel)
    high = px(HEIGHT)
    for index in sorted(preview.boxes):
        x, y, width, height = preview.boxes[index]
        name = preview.names[index] if index < len(preview.names) else ""
        why = (preview.aside or {}).get(name)
        wide, at = high * width / height, imgui.get_cursor_screen_pos()
        low = ImVec2(at.x + wide, at.y + high)
        uv = ImVec2(x / columns, y / rows), ImVec2((x + width) / columns, (y + height) / rows)
        draw.add_image_rounded(texture, at, low, *uv, theme.packed("#ffffff", FADED if why else 1.0), px(ROUNDING))
        if why:
            inset = px(7)
            for a, b in (((at.x, at.y), (low.x, low.y)), ((at.x, low.y), (low.x, at.y))):
                middle = ImVec2(0.5 * (at.x + low.x), 0.5 * (at.y + low.y))
                start = ImVec2(
                    middle.x + (inset if a[0] < b[0] else -inset), middle.y + (inset if a[1] < b[1] else -inset)
                )
                end = ImVec2(2 * middle.x - start.x, 2 * middle.y - start.y)
                draw.add_line(start, end, theme.packed(theme.WARN), px(2.5))
            draw.add_rect(at, low, theme.packed(theme.WARN, 0.8), px(ROUNDING), px(1.2))
        imgui.dummy(ImVec2(wide, high))
        if imgui.is_item_hovered():
            imgui.set_tooltip(f"{name}\nset aside: {why}" if why else name)
        imgui.same_line(0, px(GAP))


def roughly(seconds: float) -> str:
    """An estimate without digits that it does not have: "20 s", "4 min"."""
    step = 10 if seconds < 90 else 60 if seconds < 3600 else 600
    return duration(max(round(seconds / step), 1) * step).removesuffix(" 00 s")


def _status_lines(preview: BarePreview) -> list[tuple[str, str]]:
    """Lines about the pictures and the time, with their colours."""
    lines: list[tuple[str, str]] = []
    aside = preview.aside or {}
    if aside:
        named = [f"{name} ({why})" for name, why in list(aside.items())[:NAMED]]
        more = f" and {len(aside) - NAMED} more" if len(aside) > NAMED else ""
        lines.append((f"{preview.used} of {preview.count} are used. Set aside: {', '.join(named)}{more}.", theme.WARN))
    elif preview.used is not None:
        lines.append(
            (f"{preview.used} {'frames at most' if preview.of_film else 'photographs'} are used.", theme.FAINT)
        )
    elif preview.count is not None:
        lines.append((f"Looking at the pictures: {len(preview.names)} of {preview.count}", theme.FAINT))
    seconds = preview.seconds_in_all
    if seconds is not None:
        text = f"Finding camera poses takes about {roughly(seconds)}, as measured on this computer."
        lines.append((text, theme.FAINT))
    elif not preview.finished and preview.aside is not None:
        lines.append(("Measuring how long it takes to find the camera poses…", theme.FAINT))
    return lines


# --- Photographs that are left out, as small pictures in a row, with the reason where the mouse rests ---

REJECTED_HEIGHT = 52.0
IMAGE = "left out"


def show_rejected(canvas: Canvas, rejected: RejectedPhotographs) -> None:
    """Draws a line that counts and names them, and the row."""
    names = list(rejected.why)
    count = "1 photograph is left out" if len(names) == 1 else f"{len(names)} photographs are left out"
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    named = ", ".join(f"{name} ({rejected.why[name]})" for name in names[:NAMED])
    hint(f"{count}: {named}{more}.", theme.WARN)
    if rejected.sheet is None:
        return
    texture = imgui.ImTextureRef(canvas.image(IMAGE, rejected.sheet))
    flags = imgui.WindowFlags_.horizontal_scrollbar | imgui.WindowFlags_.no_background
    imgui.begin_child("##left out", ImVec2(0, px(REJECTED_HEIGHT + BAR)), 0, flags)
    wheel = imgui.get_io().mouse_wheel
    if wheel and imgui.is_window_hovered():
        imgui.set_scroll_x(imgui.get_scroll_x() - px(60) * wheel)
    rows, columns = rejected.sheet.shape[:2]
    for name, (x, y, width, height) in rejected.boxes.items():
        at, wide, high = imgui.get_cursor_screen_pos(), px(REJECTED_HEIGHT) * width / height, px(REJECTED_HEIGHT)
        uv = ImVec2(x / columns, y / rows), ImVec2((x + width) / columns, (y + height) / rows)
        low = ImVec2(at.x + wide, at.y + high)
        imgui.get_window_draw_list().add_image_rounded(texture, at, low, *uv, theme.packed("#ffffff"), px(ROUNDING))
        imgui.dummy(ImVec2(wide, high))
        if imgui.is_item_hovered():
            imgui.set_tooltip(f"{name}\n{rejected.why[name]}")
        imgui.same_line(0, px(GAP))
    imgui.end_child()
