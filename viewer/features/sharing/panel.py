"""Card with the address under which the open pack is shared."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core.theme import Fonts
from viewer.core.widgets import Box, corner_card, font, hint, px, tip


def show_card(app: App, box: Box, fonts: Fonts) -> None:
    """The card, at the lower left of the viewport's box, where no other card is."""
    server = app.sharing.server
    if server is None or app.making.job is not None or app.exporting.writing is not None:
        return
    with corner_card("##sharing", box):
        width = px(86)
        imgui.align_text_to_frame_padding()
        with font(fonts.bold, 16.0):
            imgui.text_unformatted(f"Sharing {server.name}")
        imgui.same_line()
        imgui.set_cursor_pos_x(imgui.get_window_width() - px(16) - width)
        if imgui.button("Stop##sharing", ImVec2(width, 0)):
            app.sharing.end()
        if not server.address:
            hint("Making the page…")
            return
        imgui.set_next_item_width(-width - px(8))
        imgui.input_text("##address", server.address, imgui.InputTextFlags_.read_only)
        imgui.same_line()
        if imgui.button(f"{fa.ICON_FA_COPY}  Copy##address", ImVec2(width, 0)):
            app.sharing.copy(app)
        tip("Open it in a browser on this computer")
        hint("Only this computer can open it, until you stop it or close the viewer.")
