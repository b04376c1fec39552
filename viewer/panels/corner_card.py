"""The card at the lower left of the viewport: what is being made, and what is asked before it goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from imgui_bundle import ImVec2, imgui

from viewer.panels import layout, theme
from viewer.panels.widgets import coloured, px

WIDTH, MARGIN = 372.0, 16.0


@contextmanager
def corner_card(name: str, box: layout.Box) -> Iterator[None]:
    """A window as high as what is in it, at the lower left of the viewport's box; name: as imgui names windows."""
    width = min(px(WIDTH), box[2] - 2 * px(MARGIN))
    at = ImVec2(box[0] + px(MARGIN), box[1] + box[3] - px(MARGIN))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0.0, 1.0))
    imgui.set_next_window_size(ImVec2(width, 0))
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_saved_settings | imgui.WindowFlags_.no_nav
    flags |= (
        imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_focus_on_appearing | imgui.WindowFlags_.always_auto_resize
    )
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(16), px(14)))
    with coloured(window_bg=theme.CARD):
        imgui.begin(name, None, flags)
    imgui.pop_style_var()
    try:
        yield
    finally:
        imgui.end()
