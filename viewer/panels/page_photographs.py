"""The photographs that the pack was made from: where they stood, and how well the picture agrees with them."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.commands import run
from viewer.app.files import FileRequest
from viewer.app.photographs import Photographs
from viewer.canvas import Canvas
from viewer.panels import theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, coloured, figure, font, hint, label, px, segments, switch

HOW = {"wipe": "Wipe", "flip": "Flip", "difference": "Difference"}
LIST_HEIGHT = 210.0


def show(app: App, canvas: Canvas, fonts: Fonts) -> None:
    """Draws the page."""
    comparison = app.comparison
    photographs = comparison.photographs
    if photographs is None or not len(photographs):
        with card("none", fonts, "Cameras"):
            hint("This pack does not tell where its photographs were taken. Packs made by snerg-make do.")
        return
    with card("cameras", fonts, "Cameras"):
        label("Show in the scene")
        on = switch("frusta", comparison.frusta)
        if on != comparison.frusta:
            comparison.frusta = on
            app.touch()
        if len(photographs.splits) > 1:
            options = ["", *photographs.splits]
            picked = segments("split", options, comparison.split_shown, {"": "all"})
            if picked is not None:
                comparison.split_shown = picked
        _list(app, photographs)
    if comparison.against == "photograph":
        compare_controls(app, fonts, "Against the photograph")
    with card("folder", fonts, "Scene folder"):
        hint(str(photographs.folder) if photographs.folder else "not known")
        if imgui.button(f"{fa.ICON_FA_FOLDER_OPEN}  Choose…", ImVec2(-1, 0)):
            app.file_request = FileRequest("The folder of photographs", "folder", photographs.look_in)


def _list(app: App, photographs: Photographs) -> None:
    comparison = app.comparison
    width = (imgui.get_content_region_avail().x - px(8)) / 2
    if imgui.button(f"{fa.ICON_FA_ARROW_LEFT}  Before", ImVec2(width, 0)):
        run(app, "last-photo")
    imgui.same_line()
    if imgui.button(f"Next  {fa.ICON_FA_ARROW_RIGHT}", ImVec2(width, 0)):
        run(app, "next-photo")
    with coloured(child_bg=theme.BASE):
        imgui.begin_child("##shots", ImVec2(0, px(LIST_HEIGHT)), imgui.ChildFlags_.always_use_window_padding)
    for i, shot in enumerate(photographs.shots):
        if comparison.split_shown in ("", shot.split):
            chosen = i == comparison.photograph and app.scene is not None and app.scene.rig.held is not None
            if imgui.selectable(f"{shot.name}##{i}", chosen)[0]:
                stand_in(app, i)
            imgui.same_line()
            x = imgui.get_window_width() - px(26) - imgui.calc_text_size(shot.split).x
            imgui.set_cursor_pos_x(x)
            with coloured(text=theme.FAINT):
                imgui.text_unformatted(shot.split)
    imgui.end_child()


def stand_in(app: App, index: int) -> None:
    """Stands in a photograph; what cannot be read is a dialog."""
    try:
        app.comparison.stand_in(app, index)
    except Exception as error:  # the camera is there all the same
        app.messages.fail("The photograph cannot be shown", error)


def compare_controls(app: App, fonts: Fonts, title: str) -> None:
    """How two pictures are compared; shared with the page of packs."""
    comparison = app.comparison
    with card("compare", fonts, title):
        picked = segments("how", list(HOW), comparison.how, HOW)
        if picked in ("wipe", "flip", "difference"):
            comparison.how = picked
            app.touch()
        if comparison.how == "difference":
            label("Amplified")
            changed, value = imgui.slider_float("##gain", comparison.gain, 1.0, 32.0, "%.0f ×")
            if changed:
                comparison.gain = value
                app.touch()
        elif comparison.how == "wipe":
            hint("Drag the edge in the picture.")
        if comparison.against == "photograph":
            with font(fonts.bold, 26.0):
                known = comparison.psnr_db is not None
                imgui.text_unformatted(f"{comparison.psnr_db:.2f}" if known else "…")
            imgui.same_line(0, px(5))
            imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + px(9))
            with coloured(text=theme.MUTED):
                imgui.text_unformatted("dB PSNR")
            width, height = comparison.psnr_size
            if comparison.psnr_db is not None:
                figure("Measured at", f"{width} × {height}", fonts)
            shots = comparison.photographs.shots if comparison.photographs else []
            index = comparison.photograph
            if index is not None and index < len(shots) and any(shots[index].camera.distortion):
                hint("The lens's distortion is not drawn, so that the edges differ.")
        if imgui.button("End comparison", ImVec2(-1, 0)):
            comparison.drop_other(app) if comparison.against == "pack" else comparison.stop()
            app.touch()
