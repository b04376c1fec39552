"""The picture, and the mouse over it: turns drags, wheel and double clicks into movements of the camera."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from imgui_bundle import ImVec2, imgui

from console.progress import duration
from viewer.app.application import App
from viewer.app.frame import draw_frame
from viewer.core import screen, theme
from viewer.core.state import Viewport
from viewer.core.widgets import Box, button, chip, elided, in_front, px, style
from viewer.features.bookmarks import panel as bookmarks_panel
from viewer.features.camera.panel import show_axes
from viewer.features.comparison import panel as comparison_panel
from viewer.features.crop import crop
from viewer.features.crop import panel as crop_panel
from viewer.features.crop.panel import CropGizmo
from viewer.features.display import panel as display_panel
from viewer.features.editing import panel as editing_panel
from viewer.features.film import panel as film_panel
from viewer.features.measuring import panel as measuring_panel
from viewer.features.opening import panel as opening_panel
from viewer.features.photographs import panel as photographs_panel
from viewer.features.placing import panel as placing_panel
from viewer.interface import layout
from viewer.rendering.canvas import Canvas

LEFT, RIGHT, MIDDLE = 0, 1, 2
ANY_BUTTON = sum(getattr(imgui.ButtonFlags_, f"mouse_button_{name}") for name in ("left", "right", "middle"))
TOAST_WIDTH = 560.0
KEY_HEIGHTS_PER_S = 0.4  # an arrow key is a drag of so many picture heights a second


def show(app: App, canvas: Canvas, box: Box, gizmo: CropGizmo) -> None:
    """Draws the picture into `box`, on the card as well, and listens to the mouse there."""
    io = imgui.get_io()
    app.viewport = Viewport(*box, io.display_framebuffer_scale.x)
    app.viewport.camera = app.camera() if app.scene is not None else None
    draw_frame(app, canvas)
    if app.kiosk is not None and app.filming.playing:
        imgui.set_mouse_cursor(imgui.MouseCursor_.none)
    flags = imgui.WindowFlags_.no_background  # the frame is cleared with that colour, and to fill it again takes time
    if app.scene is not None:
        flags |= imgui.WindowFlags_.no_scroll_with_mouse  # the wheel is the camera's
    layout.begin("##viewport", box, (0, 0), flags)
    if app.scene is None:
        opening_panel.show_start_page(app)
    else:
        screen.draw_layers(canvas.layers, box)
        comparison_panel.draw_comparison(app, canvas, box)
        show_axes(app, box)
        if gizmo.over:
            imgui.dummy(ImVec2(box[2], box[3]))  # never hovered, and so the gizmo's
        else:
            imgui.invisible_button("##canvas", ImVec2(box[2], box[3]), ANY_BUTTON)
        over = not gizmo.over and (imgui.is_item_hovered() or imgui.is_item_active())
        placing_panel.draw(app, box)
        film_panel.draw_path(app, box)
        shot, face = photographs_panel.draw(app, canvas, box), crop_panel.draw_crop(app, box)
        mark, place = measuring_panel.draw(app, box, over), bookmarks_panel.draw(app, box, over)
        editing_panel.draw(app, box, over)
        if not gizmo.over:
            _mouse(app, box, _Under(face, shot, mark, place) if over else NOTHING)
        gizmo.show(app, box)
        _corner(app, box)
        display_panel.show_legend(app, box)
    _toast(app, box)
    _progress(app, box)
    imgui.end()


class _Under(NamedTuple):
    """What is under the mouse: a handle of the crop box, a photograph's frustum, a measured point, an annotated place."""

    face: int | None = None
    shot: int | None = None
    mark: measuring_panel.Handle | None = None
    place: int | None = None  # index of its bookmark


NOTHING = _Under()


@dataclass
class _MouseState:
    """What the mouse holds since its `button` went down."""

    holds: str = ""  # the camera, or "wipe": its edge, "face": of the crop box, "mark": a point, "erase": its tool
    button: int = LEFT
    under: _Under = NOTHING
    scene: int = 0  # id of the scene that this belongs to
    travelled: float = 0.0  # window units since then, to tell a click from a drag
    moves_by_keys: bool = False  # keys are held that move the camera


_mouse_state = _MouseState()  # one mouse


def _mouse(app: App, box: Box, under: _Under) -> None:
    io, rig = imgui.get_io(), app.open_scene.rig
    at = io.mouse_pos.x - box[0], io.mouse_pos.y - box[1]
    hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
    dx, dy = io.mouse_delta.x / box[3], io.mouse_delta.y / box[3]
    if _mouse_state.scene != id(app.scene):  # another was opened while a button was down
        _mouse_state.scene, _mouse_state.holds, _mouse_state.under = id(app.scene), "", NOTHING
    if imgui.is_item_activated():
        dx = dy = 0.0  # in a slow frame, that is how the mouse came to where it was pressed
        _mouse_state.under, _mouse_state.travelled = under, 0.0
        _mouse_state.button = next((b for b in (LEFT, RIGHT, MIDDLE) if imgui.is_mouse_clicked(b)), LEFT)
        _mouse_state.holds = _held(app, box)
        if _mouse_state.holds != "wipe":
            rig.remember()
        if _mouse_state.holds == "erase":
            app.erasing.press(app, *at, subtracts=io.key_ctrl)
    if (active or imgui.is_item_deactivated()) and (dx or dy):  # the last way and the release may come in one frame
        _mouse_state.travelled += abs(io.mouse_delta.x) + abs(io.mouse_delta.y)
        _drag(app, box, dx, dy)
        app.touch()
    if hovered and imgui.is_mouse_double_clicked(LEFT):
        if app.measure_tool.finish(app):
            _mouse_state.travelled = math.inf  # it is no click any more
        elif not app.measure_tool.tool and not app.erasing.tool:
            app.pivot_at(*at)
    if imgui.is_item_deactivated() and _mouse_state.holds == "erase":
        app.erasing.release(app)
    elif imgui.is_item_deactivated() and _mouse_state.travelled < px(4):
        _click(app, *at)
    if hovered and io.mouse_wheel:
        if rig.looks_around:
            speed = app.walking.faster(io.mouse_wheel) if rig.walking else rig.faster(io.mouse_wheel)
            app.messages.say(f"Speed {speed:.3g} units per second")
        else:
            rig.remember()
            rig.dolly(io.mouse_wheel, ((2.0 * at[0] - box[2]) / box[3], (box[3] - 2.0 * at[1]) / box[3]))
        app.touch()
    if not io.want_text_input and not io.key_ctrl and not in_front(app) and not app.interface.help_shown:
        _move_by_keys(app)


def _held(app: App, box: Box) -> str:
    if app.erasing.tool and _mouse_state.button == LEFT and not imgui.get_io().key_shift:
        return "erase"
    if _mouse_state.under.face is not None:
        return "face"
    if _mouse_state.under.mark is not None and _mouse_state.button == LEFT:
        return "mark"
    return "wipe" if comparison_panel.wipe_edge_hovered(app, box) else ""


def _click(app: App, x: float, y: float) -> None:
    """A button went down and up at one place (window units from the picture's corner)."""
    review, left, under = app.making.review, _mouse_state.button == LEFT, _mouse_state.under
    if left and review is not None and review.picking:
        review.pick_ground(app, x, y)
    elif _mouse_state.holds == "mark" and under.mark is not None:
        app.measure_tool.click_point(app, *under.mark)
    elif left and app.measure_tool.tool:
        app.measure_tool.click(app, x, y)
    elif under.place is not None:
        app.bookmarks.go(app, under.place)
    elif under.shot is not None:
        photographs_panel.stand_in(app, under.shot)


def _drag(app: App, box: Box, dx: float, dy: float) -> None:
    """The mouse moved by dx, dy (picture heights) while it holds something."""
    rig, io, under = app.open_scene.rig, imgui.get_io(), _mouse_state.under
    x, y = io.mouse_pos.x - box[0], io.mouse_pos.y - box[1]
    if _mouse_state.holds == "wipe":
        app.comparison.split = min(max(x / box[2], 0.02), 0.98)
    elif _mouse_state.holds == "face":
        if app.settings.crop is not None and under.face is not None:
            camera = app.camera()
            moved = (dx * camera.height, dy * camera.height)
            app.set(crop=crop.dragged(app.open_scene.pack, app.settings.crop, under.face, camera, moved))
    elif _mouse_state.holds == "mark":
        if under.mark is not None and _mouse_state.travelled >= px(4):
            app.measure_tool.move_point(app, *under.mark, x, y)
    elif _mouse_state.holds == "erase":
        app.erasing.drag(app, x, y)
    else:
        sides = (LEFT, MIDDLE) if rig.bounded else (MIDDLE,) if app.erasing.tool else (RIGHT, MIDDLE)
        pans = _mouse_state.button in sides or (_mouse_state.button == LEFT and io.key_shift)
        if pans and not rig.walking:
            rig.pan(dx, dy)
        else:
            rig.orbit(dx, dy)


def _move_by_keys(app: App) -> None:
    """What held keys do: W A S D Q E (their places) and the arrows while flying and walking, else the arrows alone."""
    rig, keyboard, io = app.open_scene.rig, app.keyboard, imgui.get_io()
    seconds = min(io.delta_time, 0.1)
    across, along, up = keyboard.axis("Right", "Left"), keyboard.axis("Up", "Down"), 0.0
    if rig.looks_around:
        across, along = across + keyboard.axis("D", "A"), along + keyboard.axis("W", "S")
        up = keyboard.axis("E", "Q")
    if not (across or along or up):
        _mouse_state.moves_by_keys = False
        return
    if not _mouse_state.moves_by_keys:  # the whole way is one step to be undone
        rig.remember()
    _mouse_state.moves_by_keys = True
    if rig.looks_around:
        pace = 3.0 if io.key_shift else 1.0
        rig.fly(pace * min(max(across, -1.0), 1.0), pace * up, pace * min(max(along, -1.0), 1.0), seconds)
    else:  # the camera goes where the arrow points, so that the scene moves the other way
        dx, dy = -KEY_HEIGHTS_PER_S * seconds * across, KEY_HEIGHTS_PER_S * seconds * along
        rig.pan(dx, dy) if io.key_shift != rig.bounded else rig.orbit(dx, dy)
    app.touch()


def _corner(app: App, box: Box) -> None:
    """Names what is shown where it is not the usual picture."""
    notes = []
    if app.settings.mode != "normal":
        notes.append(app.settings.mode.replace("-", " "))
    rig = app.open_scene.rig
    if rig.looks_around:
        notes.append("walking" if rig.walking else "flying")
    if rig.orthographic and rig.held is None:
        notes.append("orthographic")
    comparison, gallery = app.comparison, app.gallery
    if comparison.against == "photograph" and gallery.chosen is not None:
        name = gallery.photographs.shots[gallery.chosen].name
        known = comparison.psnr_db is not None
        notes.append(f"{name}   {comparison.psnr_db:.2f} dB" if known else name)
    sides = comparison.sides(app)
    if sides is not None and comparison.how == "flip":
        notes.append(sides[comparison.other_side])
    x = box[0] + px(14)
    for note in notes:
        x = chip(note, x, box[1] + px(14)) + px(8)
    if sides is not None and comparison.how == "wipe":
        comparison_panel.draw_sides(sides, comparison.split, box, box[1] + px(52 if notes else 14))


def _toast(app: App, box: Box) -> None:
    """What was said just now, at the foot of the picture, in as many lines as it takes; a stripe marks a warning."""
    text, warning = app.messages.toast, app.messages.toast_level != "info"
    if app.messages.toast_left <= 0 or app.kiosk is not None:
        return
    draw, room = imgui.get_window_draw_list(), min(px(TOAST_WIDTH), box[2] - px(64))
    size = imgui.calc_text_size(text, wrap_width=room)
    x, y = box[0] + 0.5 * (box[2] - size.x), box[1] + box[3] - px(36) - size.y
    low, high = ImVec2(x - px(14), y - px(8)), ImVec2(x + size.x + px(14), y + size.y + px(8))
    draw.add_rect_filled(low, high, theme.packed(theme.BASE, 0.88), px(10))
    if warning:
        top, foot = ImVec2(low.x + px(4), low.y + px(7)), ImVec2(low.x + px(7), high.y - px(7))
        draw.add_rect_filled(top, foot, theme.packed(theme.WARN))
    font, colour = imgui.get_font(), theme.packed(theme.TEXT)
    draw.add_text(font, imgui.get_font_size(), ImVec2(x, y), colour, text, wrap_width=room)


def _progress(app: App, box: Box) -> None:
    """A card at the foot of the picture while a pack is being read or something is being exported."""
    export = app.filming.export
    if app.loading is not None:
        title, share = f"Opening {app.loading.path.name}", app.loading.share
    elif export is not None:
        left = export.seconds_left
        title = f"Writing {export.target.name}" + (f", {duration(left)} left" if left is not None else "")
        share = export.share
    else:
        return
    width, height = min(px(380), box[2] - px(24)), px(84)
    x, y = box[0] + 0.5 * (box[2] - width), box[1] + box[3] - height - px(20)
    imgui.set_cursor_screen_pos(ImVec2(x, y))
    with style(window_padding=(16, 12)):
        imgui.begin_child("##progress", ImVec2(width, height), imgui.ChildFlags_.always_use_window_padding)
    imgui.align_text_to_frame_padding()
    imgui.text_unformatted(elided(title, width - px(16 + 8 + 70 + 16)))
    imgui.same_line(width - px(16) - px(70))
    if button("Cancel", px(70)):
        app.opening.cancel(app) if app.loading is not None else app.filming.cancel(app)
    imgui.progress_bar(share, ImVec2(-1, px(6)), "")
    imgui.end_child()
