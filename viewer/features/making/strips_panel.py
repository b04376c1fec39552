"""Strips of small pictures: photographs before a scene is made of them, and rejected ones."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui

from console.progress import duration
from viewer.core import theme
from viewer.core.widgets import hint, px
from viewer.features.making.make_job import Box, RejectedPhotographs
from viewer.features.making.survey import BarePreview, few_with_reasons
from viewer.rendering.canvas import Canvas

HEIGHT, GAP, ROUNDING, BAR = 64.0, 5.0, 4.0, 12.0
FADED = 0.28  # of the opacity, of a picture that is set aside


def show_preview(canvas: Canvas, preview: BarePreview) -> None:
    """Draws the strip, and under it what is known."""
    imgui.dummy(ImVec2(0, px(2)))
    pictures = []
    for index in sorted(preview.boxes):
        name = preview.names[index] if index < len(preview.names) else ""
        why = (preview.aside or {}).get(name)
        pictures.append((preview.boxes[index], f"{name}\nset aside: {why}" if why else name, bool(why)))
    _strip("##strip", canvas.sheet(preview), preview.sheet, HEIGHT, pictures)
    for text, colour in _status_lines(preview):
        hint(text, colour)


def _strip(name: str, texture: int, sheet: np.ndarray, height: float, pictures: list[tuple[Box, str, bool]]) -> None:
    """A row of pictures that scrolls sideways. Each: its box on the sheet, its tooltip, and whether it is crossed out."""
    flags = imgui.WindowFlags_.horizontal_scrollbar | imgui.WindowFlags_.no_background
    imgui.begin_child(name, ImVec2(0, px(height + BAR)), 0, flags)
    wheel = imgui.get_io().mouse_wheel
    if wheel and imgui.is_window_hovered():
        imgui.set_scroll_x(imgui.get_scroll_x() - px(60) * wheel)
    draw, image, (rows, columns) = imgui.get_window_draw_list(), imgui.ImTextureRef(texture), sheet.shape[:2]
    for (x, y, width, tall), tooltip, crossed in pictures:
        at, wide, high = imgui.get_cursor_screen_pos(), px(height) * width / tall, px(height)
        low = ImVec2(at.x + wide, at.y + high)
        uv = ImVec2(x / columns, y / rows), ImVec2((x + width) / columns, (y + tall) / rows)
        shade = theme.packed("#ffffff", FADED if crossed else 1.0)
        draw.add_image_rounded(image, at, low, *uv, shade, px(ROUNDING))
        if crossed:
            _cross(draw, at, low)
        imgui.dummy(ImVec2(wide, high))
        if imgui.is_item_hovered():
            imgui.set_tooltip(tooltip)
        imgui.same_line(0, px(GAP))
    imgui.end_child()


def _cross(draw: imgui.ImDrawList, at: ImVec2, low: ImVec2) -> None:
    x, y, arm = 0.5 * (at.x + low.x), 0.5 * (at.y + low.y), px(7)
    for rise in (arm, -arm):
        draw.add_line(ImVec2(x + arm, y + rise), ImVec2(x - arm, y - rise), theme.packed(theme.WARN), px(2.5))
    draw.add_rect(at, low, theme.packed(theme.WARN, 0.8), px(ROUNDING), px(1.2))


def roughly(seconds: float) -> str:
    """An estimate without digits that it does not have: "20 s", "4 min"."""
    step = 10 if seconds < 90 else 60 if seconds < 3600 else 600
    return duration(max(round(seconds / step), 1) * step).removesuffix(" 00 s")


def _status_lines(preview: BarePreview) -> list[tuple[str, str]]:
    """Lines about the pictures and the time, with their colours."""
    lines: list[tuple[str, str]] = []
    aside = preview.aside or {}
    if aside:
        lines.append((f"{preview.used} of {preview.count} are used. Set aside: {few_with_reasons(aside)}.", theme.WARN))
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
    hint(f"{count}: {few_with_reasons(rejected.why)}.", theme.WARN)
    if rejected.sheet is None:
        return
    pictures = [(box, f"{name}\n{rejected.why[name]}", False) for name, box in rejected.boxes.items()]
    _strip("##left out", canvas.image(IMAGE, rejected.sheet), rejected.sheet, REJECTED_HEIGHT, pictures)
