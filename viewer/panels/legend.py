"""What the colours of a false-colour picture mean: a bar with numbers and their unit, in the picture's lower left corner."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.panels import theme
from viewer.panels.widgets import font, px
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.shader_source import colour_stops

BAR = (200.0, 12.0)  # width, height
PADDING = 12.0
GREY = ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
COUNTED = {"samples": "voxels fetched per ray", "jumps": "jumps per ray"}
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Legend:
    """stops: colours, evenly spaced from left to right. low, middle, high: numbers below the bar. unit: what they count."""

    stops: tuple[Colour, ...]
    low: str
    middle: str
    high: str
    unit: str


def legend(app: App) -> Legend | None:
    """The legend of the mode that is shown; None where it needs none."""
    camera, mode = app.viewport.camera, app.settings.mode
    if camera is None or app.scene is None:
        return None
    if mode in COUNTED:
        scale = app.settings.cost_scale
        return Legend(colour_stops(), "0", f"{scale / 2:.0f}", f"≥ {scale:.0f}", COUNTED[mode])
    if mode == "depth":
        pack = app.scene.pack
        near, far = RayFrame(pack).depth_range(camera)
        if pack.ndc:
            return Legend(GREY, f"{near:.0f}", f"{(near + far) / 2:.0f}", f"{far:.0f}", "voxels into the warped grid")
        near, far = near * pack.voxel_size, far * pack.voxel_size
        at_least = "≥ " if pack.contraction is not None else ""
        return Legend(
            GREY, f"{near:.3g}", f"{(near + far) / 2:.3g}", f"{at_least}{far:.3g}", "distance, in the grid's units"
        )
    return None


def show(app: App, box: tuple[float, float, float, float]) -> None:
    """Draws it over the picture's box (x, y, width, height; window units), where it has room."""
    told = legend(app)
    if told is None:
        return
    draw = imgui.get_window_draw_list()
    with font(None, theme.SMALL):
        line = imgui.get_text_line_height()
        width = min(px(BAR[0]), box[2] - px(28 + 2 * PADDING))
        height = px(BAR[1]) + 2 * line + px(10)
        left, top = box[0] + px(14) + px(PADDING), box[1] + box[3] - px(14) - px(PADDING) - height
        pad = px(PADDING)
        if width < px(90) or top - pad < box[1]:
            return
        low, high = ImVec2(left - pad, top - pad), ImVec2(left + width + pad, top + height + pad)
        draw.add_rect_filled(low, high, theme.packed(theme.BASE, 0.82), px(10))
        draw.add_text(ImVec2(left, top), theme.packed(theme.MUTED), told.unit)
        y = top + line + px(4)
        _bar(draw, told.stops, ImVec2(left, y), width, px(BAR[1]))
        y += px(BAR[1]) + px(4)
        for text, place in ((told.low, 0.0), (told.middle, 0.5), (told.high, 1.0)):
            wide = imgui.calc_text_size(text).x
            draw.add_text(ImVec2(left + place * (width - wide), y), theme.packed(theme.TEXT), text)


def _bar(draw: imgui.ImDrawList, stops: tuple[Colour, ...], corner: ImVec2, width: float, height: float) -> None:
    packed = [imgui.color_convert_float4_to_u32(imgui.ImVec4(*stop, 1.0)) for stop in stops]
    step = width / (len(stops) - 1)
    for i, (a, b) in enumerate(pairwise(packed)):
        low = ImVec2(corner.x + i * step, corner.y)
        draw.add_rect_filled_multi_color(low, ImVec2(low.x + step, corner.y + height), a, b, b, a)
    draw.add_rect(corner, ImVec2(corner.x + width, corner.y + height), theme.packed(theme.LINE))
