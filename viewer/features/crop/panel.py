"""Crop page, and the box in the picture whose faces are dragged.

ImGuizmo only takes hold of the mouse where no widget is under it, so that the picture must not be one while `over`.
"""

import numpy as np
from imgui_bundle import icons_fontawesome_6 as fa
from imgui_bundle import imgui, imguizmo

from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.pose import BOX_EDGES
from viewer.core.screen import AXIS_COLOURS, Screen
from viewer.core.widgets import Box, px
from viewer.features.crop import crop
from viewer.rendering.camera import ViewCamera, box_points
from viewer.rendering.canvas import Canvas

TOOLS: dict[crop.Tool, tuple[str, str]] = {
    "faces": ("Faces", "Drag the dots on the box's faces in the picture."),
    "move": ("Move", "Drag the arrows in the picture, or the squares between them."),
    "scale": ("Scale", "Drag the knobs in the picture to scale about the middle."),
}


def show(app: App, canvas: Canvas) -> None:
    pack = app.open_scene.pack
    if app.open_scene.rig.bounded:
        with ui.card("none", "Crop box"):
            ui.hint("Forward-facing packs use a warped space (NDC), where a crop box does not work.")
        return
    with ui.card("crop", "Crop box"):
        if ui.switch("crop", app.settings.crop is not None, "Crop to a box") != (app.settings.crop is not None):
            app.cut(crop=crop.whole(pack) if app.settings.crop is None else None)
        if app.settings.crop is None:
            ui.hint("The whole scene is shown.")
        else:
            app.crop_tool = ui.explained("##tool", TOOLS, app.crop_tool)
            low, high = crop.whole(pack)
            for face, (axis, side) in enumerate(crop.FACES):
                name, before = f"{'xyz'[axis]} {'from' if side == 0 else 'to'}", app.settings.crop
                value = ui.undoable_slider(app, name, before[side][axis], low[axis], high[axis], "%.3f")
                if value is not None:
                    app.set(crop=crop.with_face(pack, before, face, value))
            if ui.button(f"{fa.ICON_FA_ROTATE_LEFT}  Reset the box", enabled=app.settings.crop != crop.whole(pack)):
                app.cut(crop=crop.whole(pack))
            ui.tip("To the whole scene")
    with ui.card("near", "Slice"):
        near_plane(app)
        ui.hint("Hides everything closer to the camera than this, in grid units.")


def near_plane(app: App) -> None:
    """The row with the near plane's slider and its reset; one drag is one step to be undone."""
    ui.label("Near plane")
    imgui.set_next_item_width(-px(34) - px(8))
    value = ui.undoable_slider(app, "##near", app.settings.near, 0.0, 3.0 * app.open_scene.rig.radius, "%.3f")
    ui.tip("Hide everything closer than this, in grid units")
    if value is not None:
        app.set(near=value)
    imgui.same_line()
    if ui.icon_button(fa.ICON_FA_ROTATE_LEFT, "near reset", "Reset the near plane", enabled=app.settings.near > 0):
        app.cut(near=0.0)


# --- ImGuizmo on the crop box ---
gizmo = imguizmo.im_guizmo
SIZE = 0.17  # length of an arrow over the picture's height
OPERATIONS = {"move": gizmo.OPERATION.translate, "scale": gizmo.OPERATION.scale}


class CropGizmo:
    """over: whether the mouse is on it or holds it."""

    def __init__(self) -> None:
        self.over = False
        self._held = False

    def show(self, app: App, box: Box) -> None:
        """Draws it over the picture's box, where it is wanted, and applies what the mouse does to it."""
        camera, cut = app.viewport.camera, app.settings.crop
        operation = OPERATIONS.get(app.crop_tool)
        hidden = not app.interface.shows("crop")
        if hidden or camera is None or cut is None or operation is None:
            self.over = self._held = False
            return
        gizmo.set_im_gui_context(imgui.get_current_context())
        gizmo.begin_frame()
        gizmo.set_drawlist()
        gizmo.set_rect(*box)
        gizmo.set_orthographic(camera.orthographic)
        gizmo.set_gizmo_size_clip_space(SIZE)
        style = gizmo.get_style()
        style.translation_line_thickness = style.scale_line_thickness = px(4)
        style.translation_line_arrow_size, style.scale_line_circle_size = px(8), px(7)
        low, high = np.asarray(cut[0]), np.asarray(cut[1])
        size = high - low
        matrix = np.diag([*(size if app.crop_tool == "scale" else np.ones(3)), 1.0])
        matrix[:3, 3] = 0.5 * (low + high)
        held, view = _matrix16(matrix), _matrix16(np.linalg.inv(camera.grid_T_camera))
        projection = _projection(camera, app.open_scene.rig.radius)
        changed = gizmo.manipulate(view, projection, operation, gizmo.MODE.world, held)
        using = gizmo.is_using()
        if using and not self._held:
            app.open_scene.rig.remember()
        self.over, self._held = using or gizmo.is_over(), using
        if changed:
            moved = np.asarray(held.values, np.float64).reshape(4, 4).T
            scaled = np.linalg.norm(moved[:3, :3], axis=0) if app.crop_tool == "scale" else size
            app.set(crop=crop.placed(app.open_scene.pack, moved[:3, 3], scaled))
            app.touch()


def _matrix16(matrix: np.ndarray) -> gizmo.Matrix16:
    """Column after column, as OpenGL has matrices."""
    return gizmo.Matrix16(matrix.T.ravel().tolist())


def _projection(camera: ViewCamera, radius: float) -> gizmo.Matrix16:
    """OpenGL's projection for a camera; near and far only order what is drawn."""
    near, far = 0.01 * radius, 100.0 * radius
    x, y = 2 * camera.fx / camera.width, 2 * camera.fy / camera.height
    a, b = 2 * camera.cx / camera.width - 1, 1 - 2 * camera.cy / camera.height
    if camera.orthographic:
        z, c = -2 / (far - near), -(far + near) / (far - near)
        rows = [(x, 0, 0, a), (0, y, 0, b), (0, 0, z, c), (0, 0, 0, 1)]
    else:
        z, c = -(far + near) / (far - near), -2 * far * near / (far - near)
        rows = [(x, 0, -a, 0), (0, y, -b, 0), (0, 0, z, c), (0, 0, -1, 0)]
    return _matrix16(np.array(rows, float))


def draw_crop(app: App, box: Box) -> int | None:
    """The crop box with a handle on each face; the face whose handle is under the mouse, if any."""
    if app.settings.crop is None or not app.interface.shows("crop"):
        return None
    screen, mouse = Screen(app, box), imgui.get_io().mouse_pos
    low, high = np.asarray(app.settings.crop[0]), np.asarray(app.settings.crop[1])
    corners = box_points(low, high)
    screen.outlined_lines(corners, BOX_EDGES, theme.ACCENT, 1.5, 3, shade=0.5)
    if app.crop_tool != "faces":
        return None
    places, before = screen.points(np.array([crop.face_centre(app.settings.crop, face) for face in range(6)]))
    draw, under = imgui.get_window_draw_list(), None
    for face, place in enumerate(places):
        if before[face]:
            hot = np.hypot(place.x - mouse.x, place.y - mouse.y) < px(12)
            under = face if hot else under
            draw.add_circle_filled(place, px(9 if hot else 7), theme.packed(theme.BASE, 0.8))
            draw.add_circle_filled(place, px(7 if hot else 5), theme.packed(AXIS_COLOURS[crop.FACES[face][0]]))
    return under
