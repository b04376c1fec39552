"""The photographs that the pack was made from: where they stood, and how well the picture agrees with them."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.app.commands import run
from viewer.app.files import FileRequest, existing_folder
from viewer.app.photographs import Photographs
from viewer.panels import frusta, theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, coloured, figure, font, hint, label, px, segments, switch, tip

HOW = {"wipe": "Wipe", "flip": "Flip", "difference": "Difference"}
ROW, THUMBNAIL = 46.0, 54.0
SMALLEST_LIST = 4.3  # rows
FOLDER_HEIGHT, MORE_WORDS = 136.0, 32.0  # of what lies below the list; and where the photographs are elsewhere
LOGARITHMIC = imgui.SliderFlags_.logarithmic


def show(app: App, canvas: CanvasInterface, fonts: Fonts) -> None:
    """Draws the page."""
    comparison, gallery = app.comparison, app.gallery
    photographs = gallery.photographs
    if photographs is None or not len(photographs):
        with card("none", fonts, "Cameras"):
            hint("This pack has no camera poses. Packs made by snerg-make have them.")
        return
    with card("cameras", fonts, "Cameras"):
        label("Show in the scene")
        on = switch("frusta", gallery.frusta)
        if on != gallery.frusta:
            gallery.frusta = on
            app.touch()
        if len(photographs.splits) > 1:
            options = ["", *photographs.splits]
            picked = segments("split", options, gallery.split_shown, {"": "all"})
            if picked is not None:
                gallery.split_shown, gallery.reveal = picked, True
                app.touch()
        if gallery.frusta and comparison.against != "photograph":
            _look_of_frusta(app)
    if comparison.against == "photograph":
        compare_controls(app, fonts, "Compare with the photograph")
    bottom = imgui.get_window_pos().y + imgui.get_window_height()
    with card("list", fonts, _list_title(app)):
        _list(app, canvas, photographs, bottom)
    with card("folder", fonts, "Scene folder"):
        hint(_where(photographs))
        if gallery.thumbnails is not None and gallery.thumbnails.problem:
            hint(gallery.thumbnails.problem, theme.WARN)
        if imgui.button(f"{fa.ICON_FA_FOLDER_OPEN}  Choose…", ImVec2(-1, 0)):
            start = existing_folder(photographs.folder) if photographs.folder else None
            app.file_request = FileRequest("The folder of photographs", "folder", photographs.look_in, start=start)


def _where(photographs: Photographs) -> str:
    """Where the photographs come from, in words."""
    if photographs.reachable:
        return str(photographs.folder)
    if photographs.any_pictures:
        return "These copies came with the pack. Choose the folder of the scene to use its own files."
    there = f" They were in {photographs.folder}." if photographs.folder else ""
    return f"The photographs are not on this computer.{there} Choose their folder to see them here."


def _look_of_frusta(app: App) -> None:
    gallery = app.gallery
    label("Size")
    changed, value = imgui.slider_float("##size", 100 * gallery.frusta_size, 25.0, 400.0, "%.0f %%", LOGARITHMIC)
    if changed:
        gallery.frusta_size = value / 100
        app.touch()
    label("Opacity")
    changed, value = imgui.slider_float("##opacity", 100 * gallery.frusta_opacity, 0.0, 100.0, "%.0f %%")
    tip("Of the photographs in the scene; at 0 only their outlines are drawn")
    if changed:
        gallery.frusta_opacity = value / 100
        app.touch()


def _list_title(app: App) -> str:
    visible, chosen = app.gallery.visible(), app.gallery.chosen
    photographs = app.gallery.photographs
    what = "photographs" if photographs is not None and photographs.any_pictures else "cameras"
    return f"{visible.index(chosen) + 1} of {len(visible)}" if chosen in visible else f"{len(visible)} {what}"


def _list(app: App, canvas: CanvasInterface, photographs: Photographs, bottom: float) -> None:
    """bottom: the page's lower edge, in window units."""
    width = (imgui.get_content_region_avail().x - px(8)) / 2
    if imgui.button(f"{fa.ICON_FA_ARROW_LEFT}  Previous", ImVec2(width, 0)):
        run(app, "last-photo")
    tip("B")
    imgui.same_line()
    if imgui.button(f"Next  {fa.ICON_FA_ARROW_RIGHT}", ImVec2(width, 0)):
        run(app, "next-photo")
    tip("N")
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(4), px(4)))
    imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(0, 0))
    # As high as the page has room for, with the folder's card below it.
    folder = FOLDER_HEIGHT if photographs.reachable else FOLDER_HEIGHT + MORE_WORDS
    room = bottom - imgui.get_cursor_screen_pos().y - px(folder)
    height = max(room, px(SMALLEST_LIST * ROW))
    with coloured(child_bg=theme.BASE):
        imgui.begin_child("##shots", ImVec2(0, height), imgui.ChildFlags_.always_use_window_padding)
    visible = app.gallery.visible()
    _reveal(app, visible)
    clipper = imgui.ListClipper()
    clipper.begin(len(visible), px(ROW))
    while clipper.step():
        for place in range(clipper.display_start, clipper.display_end):
            _row(app, canvas, photographs, visible[place])
    imgui.end_child()
    imgui.pop_style_var(2)


def _reveal(app: App, visible: list[int]) -> None:
    """Scrolls to the photograph that was chosen just now, unless all of it is in view already."""
    gallery = app.gallery
    if not gallery.reveal or gallery.chosen not in visible:
        return
    gallery.reveal = False
    top = visible.index(gallery.chosen) * px(ROW)
    height, scroll = imgui.get_window_height() - px(8), imgui.get_scroll_y()
    if not scroll <= top <= scroll + height - px(ROW):
        imgui.set_scroll_y(max(0.0, top - 0.5 * (height - px(ROW))))
        app.touch()


def _row(app: App, canvas: CanvasInterface, photographs: Photographs, index: int) -> None:
    shot, at = photographs.shots[index], imgui.get_cursor_screen_pos()
    width = imgui.get_content_region_avail().x
    if imgui.selectable(f"##{index}", index == app.gallery.chosen, 0, ImVec2(width, px(ROW)))[0]:
        stand_in(app, index)
    draw = imgui.get_window_draw_list()
    low, high = ImVec2(at.x + px(5), at.y + px(3)), ImVec2(at.x + px(5 + THUMBNAIL), at.y + px(ROW - 3))
    if not photographs.any_pictures:  # nothing is coming, nor is room kept for it
        high = ImVec2(at.x + px(2), high.y)
    elif not frusta.picture(canvas, app.gallery.thumbnails, index, low, high):
        draw.add_rect_filled(low, high, theme.packed(theme.CARD), px(4))
        icon = fa.ICON_FA_CAMERA
        size = imgui.calc_text_size(icon)
        middle = ImVec2(0.5 * (low.x + high.x - size.x), 0.5 * (low.y + high.y - size.y))
        draw.add_text(middle, theme.packed(theme.FAINT), icon)
    y = at.y + 0.5 * (px(ROW) - imgui.get_text_line_height())
    draw.add_text(ImVec2(high.x + px(12), y), theme.packed(theme.TEXT), shot.name)
    colour = theme.packed(theme.ACCENT_DEEP if shot.split == "train" else theme.WARN)
    draw.add_circle_filled(ImVec2(at.x + width - px(14), at.y + 0.5 * px(ROW)), px(4), colour)


def stand_in(app: App, index: int) -> None:
    """Stands in a photograph; what cannot be read is a dialog."""
    try:
        app.gallery.stand_in(app, index)
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
            photographs = app.gallery.photographs
            if photographs is not None and not photographs.reachable:
                hint("Compared with the copy in the pack.")
        if imgui.button("End comparison", ImVec2(-1, 0)):
            comparison.drop_other(app) if comparison.against == "pack" else comparison.stop()
            app.touch()
