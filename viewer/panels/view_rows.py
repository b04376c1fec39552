"""Lists of views, each with its small picture: bookmarks and keyframes."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.app.view_pictures import SIZE
from viewer.panels import theme
from viewer.panels.widgets import elided, px

HEIGHT, GAP = 44.0, 10.0
WIDTH = HEIGHT * SIZE[0] / SIZE[1]


def row(
    app: App,
    canvas: CanvasInterface,
    name: str,
    view: tuple[np.ndarray, float],
    texts: tuple[str, str],
    *,
    chosen: bool,
) -> bool:
    """A line of a list; True where it was clicked. view: grid_T_camera and vertical fov. texts: at the left and at the right."""
    at, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
    clicked = imgui.selectable(f"##{name}", chosen, 0, ImVec2(0, px(HEIGHT)))[0]
    if not imgui.is_item_visible():  # what is scrolled out needs no picture
        return clicked
    draw = imgui.get_window_draw_list()
    low, high = ImVec2(at.x, at.y), ImVec2(at.x + px(WIDTH), at.y + px(HEIGHT))
    texture = app.views.texture(app, canvas, *view)
    if texture is None:
        draw.add_rect_filled(low, high, theme.packed(theme.CONTROL), px(4))
    else:
        white, whole = theme.packed("#ffffff"), (ImVec2(0, 0), ImVec2(1, 1))
        draw.add_image_rounded(imgui.ImTextureRef(texture), low, high, *whole, white, px(4))
    middle = at.y + 0.5 * (px(HEIGHT) - imgui.get_text_line_height())
    right = imgui.calc_text_size(texts[1]).x
    left = px(WIDTH + GAP)
    shown = elided(texts[0], width - left - right - px(2 * GAP if texts[1] else GAP))
    draw.add_text(ImVec2(at.x + left, middle), theme.packed(theme.TEXT), shown)
    draw.add_text(ImVec2(at.x + width - right - px(4), middle), theme.packed(theme.MUTED), texts[1])
    return clicked
