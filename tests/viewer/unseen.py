"""Panels nobody looks at: all is handed to OpenGL as always, but no pixel is filled. In software, that is most of a frame."""

from collections.abc import Callable

from imgui_bundle import ImVec2, imgui

Draw = Callable[[imgui.ImDrawData], None]


def draw_unseen(data: imgui.ImDrawData, draw: Draw = imgui.backends.opengl3_render_draw_data) -> None:
    """Draws the panels' last frame into one pixel. Textures of letters arrive with it; the same data can be drawn whole after."""
    size = data.display_size
    whole = ImVec2(size.x, size.y)
    data.display_size = ImVec2(1.0, 1.0)
    draw(data)
    data.display_size = whole
