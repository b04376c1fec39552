"""Compare page, and two pictures in one: beside each other, in turn, or subtracted."""

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.frame import other_layers
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.screen import draw_layers
from viewer.core.state import name_of
from viewer.core.widgets import Box, px
from viewer.features.comparison.comparison import How
from viewer.features.opening.opening import ask_to_open
from viewer.rendering.canvas import Canvas

HOW: dict[How, str] = {"wipe": "Wipe", "flip": "Flip", "difference": "Difference"}


def compare_controls(app: App, title: str) -> None:
    """How two pictures are compared; shared with the page of packs."""
    comparison = app.comparison
    with ui.card("compare", title):
        comparison.how = ui.segments("##how", HOW, comparison.how) or comparison.how
        if comparison.how == "difference":
            comparison.gain = ui.slider("Amplified##gain", comparison.gain, 1.0, 32.0, "%.0f ×")
        elif comparison.how == "wipe":
            ui.hint("Drag the edge in the picture.")
        if comparison.against == "photograph":
            ui.headline("…" if comparison.psnr_db is None else f"{comparison.psnr_db:.2f}", "dB PSNR")
            width, height = comparison.psnr_size
            if comparison.psnr_db is not None:
                ui.figure("Measured at", f"{width} × {height}")
            if not app.gallery.photographs.reachable:
                ui.hint("Compared with the copy in the pack.")
        if ui.button("End comparison"):
            comparison.drop_other(app) if comparison.against == "pack" else comparison.stop()


def show(app: App, canvas: Canvas) -> None:
    comparison = app.comparison
    with ui.card("other", "The other pack"):
        if comparison.other_path is not None:
            ui.figure("Left", app.open_scene.name)
            ui.figure("Right", name_of(comparison.other_path))
        else:
            ui.hint("Choose a second pack, for example another bake of the same scene. Both use the same camera.")
        if ui.button(f"{fa.ICON_FA_FOLDER_OPEN}  Choose a pack…"):
            ask_to_open(app, other=True)
    if comparison.against == "pack":
        compare_controls(app, "Compare")


def draw_comparison(app: App, canvas: Canvas, box: Box) -> None:
    """The other picture: right of the wipe's edge, in turn, or subtracted."""
    comparison, other = app.comparison, other_layers(app, canvas)
    if not other:
        return
    if comparison.how == "difference":
        if canvas.difference is not None:
            draw_layers([canvas.difference], box)
    elif comparison.how == "flip":
        if comparison.other_side:
            draw_layers(other, box)
    else:
        draw = imgui.get_window_draw_list()
        x, y, width, height = box
        edge = x + comparison.split * width
        with ui.clipped((edge, y, x + width - edge, height)):
            draw_layers(other, box)
        draw.add_line(ImVec2(edge, y), ImVec2(edge, y + height), theme.packed(theme.BASE, 0.6), px(4))
        draw.add_line(ImVec2(edge, y), ImVec2(edge, y + height), theme.packed(theme.ACCENT), px(2))
        middle = y + height / 2
        draw.add_circle_filled(ImVec2(edge, middle), px(13), theme.packed(theme.ACCENT))
        for side in (-1, 1):
            tip, foot = ImVec2(edge + side * px(8), middle), edge + side * px(3)
            ends = ImVec2(foot, middle - px(5)), ImVec2(foot, middle + px(5))
            draw.add_triangle_filled(tip, *ends, theme.packed(theme.ON_ACCENT))


def draw_sides(names: tuple[str, str], split: float, box: Box, y: float) -> None:
    """Says at each side of the wipe's edge what is seen there. split: 0 … 1; y: upper edge of the labels."""
    edge, gap = box[0] + split * box[2], px(10)
    spans = ((box[0], edge), (edge, box[0] + box[2]))
    for name, (low, high), left in zip(names, spans, (True, False), strict=True):
        with ui.font(None, theme.SMALL):
            shown = ui.elided(name, high - low - 2 * gap - px(24))
        if not shown:
            continue
        with ui.clipped((low, box[1], high - low, box[3])):
            ui.chip(shown, high - gap - ui.chip_size(shown)[0] if left else low + gap, y)


def wipe_edge_hovered(app: App, box: Box) -> bool:
    if not app.comparison.against or app.comparison.how != "wipe":
        return False
    return abs(imgui.get_io().mouse_pos.x - (box[0] + app.comparison.split * box[2])) < px(9)
