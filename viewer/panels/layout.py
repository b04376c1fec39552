"""Where everything goes: a bar on top, a rail of icons at the right edge, the page it picks beside, the picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.canvas import Canvas
from viewer.panels import (
    page_camera,
    page_compare,
    page_crop,
    page_film,
    page_log,
    page_performance,
    page_photographs,
    page_view,
    theme,
)
from viewer.panels.theme import Fonts
from viewer.panels.widgets import coloured, font, icon_button, px

TOP, RAIL, SIDE = 48.0, 50.0, 318.0
NARROW = 620.0  # a window narrower than this has no room for a page beside the picture

Box = tuple[float, float, float, float]  # x, y, width, height in window units
FIXED = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_bring_to_front_on_focus
    | imgui.WindowFlags_.no_nav
)


@dataclass(frozen=True)
class Page:
    """One panel at the side. icon: Font Awesome. show: draws it. needs_scene: empty without a pack."""

    id: str
    title: str
    icon: str
    show: Callable[[App, Canvas, Fonts], None]


PAGES = (
    Page("view", "Picture", fa.ICON_FA_IMAGE, page_view.show),
    Page("camera", "Camera", fa.ICON_FA_VIDEO, page_camera.show),
    Page("crop", "Crop", fa.ICON_FA_CROP_SIMPLE, page_crop.show),
    Page("photographs", "Photographs", fa.ICON_FA_IMAGES, page_photographs.show),
    Page("compare", "Compare packs", fa.ICON_FA_CODE_COMPARE, page_compare.show),
    Page("film", "Stills and films", fa.ICON_FA_FILM, page_film.show),
    Page("performance", "Performance", fa.ICON_FA_GAUGE_HIGH, page_performance.show),
    Page("log", "Log", fa.ICON_FA_LIST, page_log.show),
)


@dataclass(frozen=True)
class Regions:
    """Boxes of the parts; width 0 where a part is not shown."""

    top: Box
    rail: Box
    side: Box
    viewport: Box


def regions(width: float, height: float, app: App) -> Regions:
    """Divides a window of width × height units."""
    if not app.interface.panels_shown or app.scene is None:
        top = px(TOP) if app.interface.panels_shown else 0.0
        whole = (0.0, top, width, max(1.0, height - top))
        return Regions((0.0, 0.0, width, top), (width, 0.0, 0.0, height), (width, 0.0, 0.0, height), whole)
    top, rail = px(TOP), px(RAIL)
    side = px(SIDE) if width >= px(NARROW) and app.interface.page else 0.0
    below = max(1.0, height - top)
    return Regions(
        (0.0, 0.0, width, top),
        (width - rail, top, rail, below),
        (width - rail - side, top, side, below),
        (0.0, top, max(1.0, width - rail - side), below),
    )


def begin(name: str, box: Box, padding: tuple[float, float], extra: int = 0) -> None:
    """Begins a window that stays in its box; end it with imgui.end()."""
    imgui.set_next_window_pos(ImVec2(box[0], box[1]))
    imgui.set_next_window_size(ImVec2(box[2], box[3]))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(padding[0]), px(padding[1])))
    imgui.begin(name, None, FIXED | extra)
    imgui.pop_style_var(2)


def show_side(app: App, canvas: Canvas, where: Regions, fonts: Fonts) -> None:
    """The rail, and the page that is picked."""
    if where.rail[2] <= 0:
        return
    with coloured(window_bg=theme.BASE):
        begin("##rail", where.rail, (8, 10))
    for page in PAGES:
        on = page.id == app.interface.page
        if icon_button(page.icon, page.id, page.title, on=on):
            app.interface.page = "" if on else page.id
    imgui.end()
    page = next((page for page in PAGES if page.id == app.interface.page), None)
    if page is None or where.side[2] <= 0:
        return
    begin("##side", where.side, (12, 14))
    imgui.set_cursor_pos_x(px(16))
    with font(fonts.bold, theme.LARGE):
        imgui.text_unformatted(page.title)
    imgui.dummy(ImVec2(0, px(2)))
    with coloured(window_bg=theme.PANEL, child_bg=(theme.PANEL, 0.0)):
        imgui.begin_child("##scroll", ImVec2(0, 0))
    with coloured(child_bg=theme.CARD):
        page.show(app, canvas, fonts)
    imgui.end_child()
    imgui.end()
