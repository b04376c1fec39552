"""Bookmarks page."""

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.annotations import Bookmark, named, worded
from viewer.core.screen import Screen
from viewer.core.widgets import Box, px
from viewer.features.bookmarks.bookmarks import SIZE, Rearranging
from viewer.features.film.camera_path import Keyframe
from viewer.rendering.canvas import Canvas

SHOWN = 6  # rows of the list
TEXT_HEIGHT = 72.0
NO_VIEWS = "Views that you save here are kept with the pack. Ctrl+D saves one, PageUp and PageDown step through them."


def show(app: App, canvas: Canvas) -> None:
    views = app.annotations.current.bookmarks
    with ui.card("bookmarks", "Bookmarks"):
        if ui.main_button(f"{fa.ICON_FA_BOOKMARK}  Bookmark this view"):
            app.run("bookmark")
        waits = "Click on a surface" if app.measure_tool.tool == "place" else "Annotate a place"
        ui.command(app, "annotate", f"{fa.ICON_FA_LOCATION_DOT}  {waits}###annotate")
        ui.tip("A number marks it in the picture; its bookmark has the title and the text")
        if views:
            _list(app, canvas)
            _chosen(app)
        else:
            ui.hint(NO_VIEWS)
    with ui.card("fly", "Film"):
        text = f"{fa.ICON_FA_FILM}  Film through the bookmarks"
        ui.command(app, "film-bookmarks", text, enabled=len(views) > 1)
        ui.hint("Makes them the keyframes of the camera path.")
    with ui.card("session", "Session"):
        ui.command(app, "save-session", f"{fa.ICON_FA_FLOPPY_DISK}  Save the session…")
        ui.tip("Ctrl+Shift+S")
        ui.hint("A small file with all open packs, their cameras, crops and marks. Open it like a pack.")


def _list(app: App, canvas: Canvas) -> None:
    bookmarks, views = app.bookmarks, app.annotations.current.bookmarks
    rows = min(len(views), SHOWN)
    height = rows * px(HEIGHT) + (rows - 1) * imgui.get_style().item_spacing.y + px(30)
    with ui.list_box("##bookmarks", height):
        for i, (view, key) in enumerate(zip(views, bookmarks.keyframes(app), strict=True)):
            texts = view.name, "" if view.point is None else str(i + 1)
            if row(app, canvas, f"bookmark{i}", key, texts, chosen=i == bookmarks.selected):
                bookmarks.go(app, i)


def _chosen(app: App) -> None:
    bookmarks, views = app.bookmarks, app.annotations.current.bookmarks
    index = bookmarks.selected
    if index is None or index >= len(views):
        ui.hint("Click on one to go there.")
        return
    if how := rearranging_buttons():
        bookmarks.rearrange(app, how, index)
        return
    imgui.new_line()
    ui.label("Name")
    imgui.push_id(index)
    _, name = imgui.input_text("##name", views[index].name)
    if imgui.is_item_deactivated_after_edit() and name.strip():
        bookmarks.edit(app, index, name=named(name))
    if views[index].point is not None:
        _, text = imgui.input_text_multiline("##text", views[index].text, ImVec2(-1, px(TEXT_HEIGHT)))
        if imgui.is_item_deactivated_after_edit():
            bookmarks.edit(app, index, text=worded(text))
        bookmarks.shown = ui.switch("places", bookmarks.shown, "Show places")
    imgui.pop_id()


# --- Annotated places over the picture ---

RADIUS, CARD = 13.0, 260.0  # of a number's disc; width of what is said


def draw(app: App, box: Box, over: bool) -> int | None:
    """Draws the places that are not covered; the index of the one under the mouse. over: it is over nothing but the picture."""
    views, bookmarks = app.annotations.current.bookmarks, app.bookmarks
    marked = [i for i, view in enumerate(views) if view.point is not None]
    if not marked or not bookmarks.shown:
        return None
    places, before = Screen(app, box).points(np.array([views[i].point for i in marked]))
    covered, mouse, under = bookmarks.covered(app), imgui.get_io().mouse_pos, None
    ahead = (place for place in zip(marked, places, before, strict=True) if place[2])
    seen = {i: at for i, at, _ in ahead if views[i].point not in covered}
    for i, at in seen.items():
        under = i if over and np.hypot(mouse.x - at.x, mouse.y - at.y) < px(RADIUS) else under
    with ui.clipped(box) as draw_list:
        for i, at in seen.items():
            hot = i in (under, bookmarks.selected)
            draw_list.add_circle_filled(at, px(RADIUS + 1.5), theme.packed(theme.BASE, 0.85))
            draw_list.add_circle_filled(at, px(RADIUS), theme.packed(theme.ACCENT if hot else theme.CARD))
            corner = at - imgui.calc_text_size(str(i + 1)) * 0.5
            draw_list.add_text(corner, theme.packed(theme.ON_ACCENT if hot else theme.TEXT), str(i + 1))
        said = bookmarks.selected if under is None else under
        if said in seen:
            _say(views[said], seen[said], box)
    return under


def _say(view: Bookmark, at: ImVec2, box: Box) -> None:
    """Title and text of a place, beside it, within the picture."""
    draw_list, font, size, room = imgui.get_window_draw_list(), imgui.get_font(), imgui.get_font_size(), px(CARD)
    title, text = (imgui.calc_text_size(words, wrap_width=room) for words in (view.name, view.text or " "))
    width, height = max(title.x, text.x) + px(24), title.y + (text.y + px(4) if view.text else 0.0) + px(20)
    x = max(min(at.x + px(RADIUS + 8), box[0] + box[2] - width), box[0])
    y = max(min(at.y - px(RADIUS), box[1] + box[3] - height), box[1])
    draw_list.add_rect_filled(ImVec2(x, y), ImVec2(x + width, y + height), theme.packed(theme.BASE, 0.9), px(10))
    x, y = x + px(12), y + px(10)
    draw_list.add_text(font, size, ImVec2(x, y), theme.packed(theme.TEXT), view.name, wrap_width=room)
    below = ImVec2(x, y + title.y + px(4))
    draw_list.add_text(font, size, below, theme.packed(theme.MUTED), view.text, wrap_width=room)


# --- Lists of views ---


REARRANGING: dict[Rearranging, tuple[str, str]] = {
    "up": (fa.ICON_FA_ARROW_UP, "Earlier"),
    "down": (fa.ICON_FA_ARROW_DOWN, "Later"),
    "update": (fa.ICON_FA_CAMERA, "Move it to the current camera"),
    "remove": (fa.ICON_FA_TRASH, "Remove"),
}


def rearranging_buttons() -> Rearranging | None:
    """What can be done with a chosen view of a list, as a row of buttons; the one that was pressed."""
    pressed = None
    for name, (icon, tooltip) in REARRANGING.items():
        pressed = name if ui.icon_button(icon, name, tooltip) else pressed
        imgui.same_line(0, px(2))
    return pressed


HEIGHT, GAP = 44.0, 10.0
WIDTH = HEIGHT * SIZE[0] / SIZE[1]


def row(app: App, canvas: Canvas, name: str, key: Keyframe, texts: tuple[str, str], *, chosen: bool) -> bool:
    """A line of a list of views; True where it was clicked. texts: at the left and at the right."""
    at, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
    clicked = imgui.selectable(f"##{name}", chosen, 0, ImVec2(0, px(HEIGHT)))[0]
    if not imgui.is_item_visible():  # what is scrolled out needs no picture
        return clicked
    draw, high = imgui.get_window_draw_list(), ImVec2(at.x + px(WIDTH), at.y + px(HEIGHT))
    texture = app.views.texture(app, canvas, key.grid_T_camera, key.fov)
    if texture is None:
        draw.add_rect_filled(at, high, theme.packed(theme.CONTROL), px(4))
    else:
        ui.draw_picture(texture, at, high)
    middle = at.y + 0.5 * (px(HEIGHT) - imgui.get_text_line_height())
    left, right = px(WIDTH + GAP), imgui.calc_text_size(texts[1]).x
    shown = ui.elided(texts[0], width - left - right - px(2 * GAP if texts[1] else GAP))
    draw.add_text(ImVec2(at.x + left, middle), theme.packed(theme.TEXT), shown)
    draw.add_text(ImVec2(at.x + width - right - px(4), middle), theme.packed(theme.MUTED), texts[1])
    return clicked
