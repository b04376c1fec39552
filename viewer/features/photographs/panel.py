"""Photographs page, and the cameras and pictures in the scene.

What is near fades out, and nothing is drawn while a photograph is compared, so that the view stays free.
"""

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.files import FileRequest, existing_folder
from viewer.core.pose import FRUSTUM_EDGES, project
from viewer.core.widgets import Box, px
from viewer.features.comparison.panel import compare_controls
from viewer.features.photographs.photographs import Photographs
from viewer.rendering.canvas import Canvas

ROW, THUMBNAIL = 46.0, 54.0
SMALLEST_LIST = 4.3  # rows
FOLDER_HEIGHT, MORE_WORDS = 136.0, 32.0  # of what lies below the list; and where the photographs are elsewhere


def show(app: App, canvas: Canvas) -> None:
    comparison, gallery = app.comparison, app.gallery
    photographs = gallery.photographs
    if not photographs.shots:
        with ui.card("none", "Cameras"):
            ui.hint("This pack has no camera poses. Packs made by snerg-make have them.")
        return
    with ui.card("cameras", "Cameras"):
        gallery.frusta = ui.switch("frusta", gallery.frusta, "Show in the scene")
        splits, shown = {shot.split: shot.split for shot in photographs.shots}, gallery.split_shown
        if len(splits) > 1 and (picked := ui.segments("##split", {"": "All"} | splits, shown)) is not None:
            gallery.split_shown, gallery.reveal = picked, True
        if gallery.frusta and comparison.against != "photograph":
            gallery.frusta_size = ui.slider(
                "Size", gallery.frusta_size, 25.0, 400.0, "%.0f %%", times=100, flags=imgui.SliderFlags_.logarithmic
            )
            gallery.frusta_opacity = ui.slider("Opacity", gallery.frusta_opacity, 0.0, 100.0, "%.0f %%", times=100)
            ui.tip("Of the photographs in the scene; at 0 only their outlines are drawn")
    if comparison.against == "photograph":
        compare_controls(app, "Compare with the photograph")
    bottom = imgui.get_window_pos().y + imgui.get_window_height()
    visible, chosen = gallery.visible(), gallery.chosen
    what = f"{len(visible)} {'photographs' if photographs.any_pictures else 'cameras'}"
    with ui.card("list", f"{visible.index(chosen) + 1} of {len(visible)}" if chosen in visible else what):
        _list(app, canvas, photographs, bottom)
    with ui.card("folder", "Scene folder"):
        ui.hint(_where(photographs))
        if gallery.thumbnails is not None and gallery.thumbnails.problem:
            ui.hint(gallery.thumbnails.problem, theme.WARN)
        if ui.button(f"{fa.ICON_FA_FOLDER_OPEN}  Choose…"):
            start = existing_folder(photographs.folder) if photographs.folder else None
            app.file_request = FileRequest("The folder of photographs", "folder", photographs.look_in, start=start)


def _where(photographs: Photographs) -> str:
    if photographs.reachable:
        return str(photographs.folder)
    if photographs.any_pictures:
        return "These copies came with the pack. Choose the folder of the scene to use its own files."
    there = f" They were in {photographs.folder}." if photographs.folder else ""
    return f"The photographs are not on this computer.{there} Choose their folder to see them here."


def _list(app: App, canvas: Canvas, photographs: Photographs, bottom: float) -> None:
    """bottom: the page's lower edge, in window units."""
    width = ui.half_width()
    ui.command(app, "last-photo", f"{fa.ICON_FA_ARROW_LEFT}  Previous", width)
    ui.tip("B")
    imgui.same_line()
    ui.command(app, "next-photo", f"Next  {fa.ICON_FA_ARROW_RIGHT}", width)
    ui.tip("N")
    # As high as the page has room for, with the folder's card below it.
    folder = FOLDER_HEIGHT if photographs.reachable else FOLDER_HEIGHT + MORE_WORDS
    room = bottom - imgui.get_cursor_screen_pos().y - px(folder)
    visible = app.gallery.visible()
    with (
        ui.style(window_padding=(4, 4), item_spacing=(0, 0)),
        ui.list_box("##shots", max(room, px(SMALLEST_LIST * ROW))),
    ):
        _reveal(app, visible)
        clipper = imgui.ListClipper()
        clipper.begin(len(visible), px(ROW))
        while clipper.step():
            for place in range(clipper.display_start, clipper.display_end):
                _row(app, canvas, photographs, visible[place])


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


def _row(app: App, canvas: Canvas, photographs: Photographs, index: int) -> None:
    shot, at = photographs.shots[index], imgui.get_cursor_screen_pos()
    width = imgui.get_content_region_avail().x
    if imgui.selectable(f"##{index}", index == app.gallery.chosen, 0, ImVec2(width, px(ROW)))[0]:
        stand_in(app, index)
    draw, thumbnails = imgui.get_window_draw_list(), app.gallery.thumbnails
    low, high = ImVec2(at.x + px(5), at.y + px(3)), ImVec2(at.x + px(5 + THUMBNAIL), at.y + px(ROW - 3))
    if not photographs.any_pictures:  # nothing is coming, nor is room kept for it
        high = ImVec2(at.x + px(2), high.y)
    elif thumbnails is not None and (uv := thumbnails.uv(index)) is not None:
        _, _, w, h = thumbnails.boxes[index]
        scale = min((high.x - low.x) / w, (high.y - low.y) / h)
        x, y = 0.5 * (low.x + high.x - scale * w), 0.5 * (low.y + high.y - scale * h)
        ui.draw_picture(canvas.sheet(thumbnails), ImVec2(x, y), ImVec2(x + scale * w, y + scale * h), uv)
    else:
        draw.add_rect_filled(low, high, theme.packed(theme.CARD), px(4))
        size = imgui.calc_text_size(fa.ICON_FA_CAMERA)
        middle = ImVec2(0.5 * (low.x + high.x - size.x), 0.5 * (low.y + high.y - size.y))
        draw.add_text(middle, theme.packed(theme.FAINT), fa.ICON_FA_CAMERA)
    y = at.y + 0.5 * (px(ROW) - imgui.get_text_line_height())
    draw.add_text(ImVec2(high.x + px(12), y), theme.packed(theme.TEXT), shot.name)
    colour = theme.packed(theme.ACCENT_DEEP if shot.split == "train" else theme.WARN)
    draw.add_circle_filled(ImVec2(at.x + width - px(14), at.y + 0.5 * px(ROW)), px(4), colour)


def stand_in(app: App, index: int) -> None:
    """Stands in a photograph; where that cannot be read, the camera is there all the same."""
    with app.messages.as_dialog("The photograph cannot be shown"):
        app.gallery.stand_in(app, index)


# --- In the scene ---
DEPTH, DEPTH_BOUNDED = 0.16, 0.06  # length of a frustum: of the scene's radius, and in NDC units
FADES_FROM, FADES_TO = 0.22, 0.45  # of the viewport's shorter side: a frustum larger than this is in the way
PICK_RADIUS = 9.0
PREVIEW = 150.0
Frustum = tuple[int, np.ndarray, float]  # its shot; eye and corners [5, 2], window units; how much is seen, 0 … 1


def draw(app: App, canvas: Canvas, box: Box) -> int | None:
    """Draws them; the one under the mouse, if any."""
    gallery = app.gallery
    if not gallery.frusta or app.comparison.against == "photograph":
        return None
    placed = _placed(app, box)
    mouse, over = np.array([*imgui.get_io().mouse_pos]), imgui.is_item_hovered()
    hit = (index for index, points, strength in reversed(placed) if strength > 0.2 and _hit(points, mouse))
    under = next(hit, None) if over else None
    sheet = canvas.sheet(gallery.thumbnails) if gallery.thumbnails is not None else None
    outlines = {gallery.chosen: theme.ACCENT, under: theme.TEXT}
    for frustum in sorted(placed, key=lambda each: (each[0] == under, each[0] == gallery.chosen)):
        _frustum(app, frustum, sheet, outlines.get(frustum[0]))
    if under is not None:
        _tooltip(app, under, sheet)
    return under


def _placed(app: App, box: Box) -> list[Frustum]:
    """What of the frusta is to be seen, the farthest first."""
    camera, gallery, scene = app.viewport.camera, app.gallery, app.open_scene
    assert camera is not None
    visible = gallery.visible()
    depth = gallery.frusta_size * (DEPTH_BOUNDED if scene.rig.bounded else DEPTH * scene.rig.radius)
    points = gallery.photographs.frusta(depth)[visible]
    pixels, before = project(camera, points.reshape(-1, 3))
    places = pixels.reshape(-1, 5, 2) / app.viewport.pixels_per_unit + np.array(box[:2])
    before = before.reshape(-1, 5).all(axis=1)
    extent = np.ptp(places, axis=1).max(axis=1) / min(box[2], box[3])
    strength = np.clip((FADES_TO - extent) / (FADES_TO - FADES_FROM), 0.0, 1.0) * before
    distances = np.linalg.norm(points.mean(axis=1) - camera.position, axis=1)
    farthest_first = np.argsort(-distances)
    return [(visible[i], places[i], float(strength[i])) for i in farthest_first if strength[i] > 0.01]


def _hit(points: np.ndarray, mouse: np.ndarray) -> bool:
    """Whether the mouse is on the picture's quadrangle, or at the eye."""
    corners = points[1:]
    sides = np.roll(corners, -1, axis=0) - corners
    to_mouse = mouse - corners
    turns = sides[:, 0] * to_mouse[:, 1] - sides[:, 1] * to_mouse[:, 0]
    inside = bool((turns > 0).all() or (turns < 0).all())
    return inside or float(np.hypot(*(points[0] - mouse))) < px(PICK_RADIUS)


def _frustum(app: App, frustum: Frustum, sheet: int | None, outline: str | None) -> None:
    gallery, draw_list, (index, points, strength) = app.gallery, imgui.get_window_draw_list(), frustum
    corners = [ImVec2(float(x), float(y)) for x, y in points]
    opacity = strength * (1.0 if outline else gallery.frusta_opacity)
    uv = gallery.thumbnails.uv(index) if gallery.thumbnails is not None else None
    if sheet is not None and uv is not None and opacity > 0.01:
        (u0, v0), (u1, v1) = uv
        uvs = ImVec2(u0, v0), ImVec2(u1, v0), ImVec2(u1, v1), ImVec2(u0, v1)  # clockwise, as the corners behind the eye
        _, a, b, c, d = corners
        draw_list.add_image_quad(imgui.ImTextureRef(sheet), a, b, c, d, *uvs, theme.packed("#ffffff", opacity))
    train = gallery.photographs.shots[index].split == "train"
    code = outline or (theme.ACCENT_DEEP if train else theme.WARN)
    colour = theme.packed(code, strength * (1.0 if outline else 0.8))
    dark = (theme.packed(theme.BASE, 0.7 * strength), 4.5)  # behind an outline, to be seen on any background
    for line, width in (dark, (colour, 2.0)) if outline else ((colour, 1.2),):
        for a, b in FRUSTUM_EDGES:
            draw_list.add_line(corners[a], corners[b], line, px(width))


def _tooltip(app: App, index: int, sheet: int | None) -> None:
    shot, thumbnails = app.gallery.photographs.shots[index], app.gallery.thumbnails
    if not imgui.begin_tooltip():
        return
    if sheet is not None and thumbnails is not None and (uv := thumbnails.uv(index)) is not None:
        _, _, w, h = thumbnails.boxes[index]
        scale = px(PREVIEW) / max(w, h)
        imgui.image(imgui.ImTextureRef(sheet), ImVec2(scale * w, scale * h), *uv)
    imgui.text_unformatted(shot.name)
    ui.write(f"{shot.split}   click to go there", theme.MUTED, size=theme.SMALL)
    imgui.end_tooltip()
