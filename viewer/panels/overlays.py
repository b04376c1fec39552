"""What lies over the picture: the other half of a comparison, frusta of photographs, the crop box, the camera path."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui

from viewer.app import crop
from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface, Layer
from viewer.app.frame import other_layers
from viewer.app.pose import view_camera
from viewer.app.projection import BOX_EDGES, FRUSTUM_EDGES, box_points, frustum_points, project
from viewer.panels import theme
from viewer.panels.widgets import chip, chip_size, elided, font, px

Box = tuple[float, float, float, float]
AXIS_COLOURS = ("#f2777a", "#6fd08c", "#6cb2f5")
PATH_STEPS = 24  # line segments per leg
LENS_PIECES = 12  # that a straight line is drawn as through a lens


def draw_layers(layers: list[Layer], box: Box) -> None:
    """Draws textures where they belong on the viewport's box."""
    x, y, width, height = box
    draw = imgui.get_window_draw_list()
    for layer in layers:
        x0, y0, x1, y1 = layer.box
        low, high = ImVec2(x + x0 * width, y + y0 * height), ImVec2(x + x1 * width, y + y1 * height)
        tint = imgui.color_convert_float4_to_u32((1.0, 1.0, 1.0, layer.opacity))
        draw.add_image(imgui.ImTextureRef(layer.texture), low, high, layer.uv0, layer.uv1, tint)


def draw_comparison(app: App, canvas: CanvasInterface, box: Box) -> None:
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
        draw.push_clip_rect(ImVec2(edge, y), ImVec2(x + width, y + height), True)
        draw_layers(other, box)
        draw.pop_clip_rect()
        draw.add_line(ImVec2(edge, y), ImVec2(edge, y + height), theme.packed(theme.BASE, 0.6), px(4))
        draw.add_line(ImVec2(edge, y), ImVec2(edge, y + height), theme.packed(theme.ACCENT), px(2))
        middle = ImVec2(edge, y + height / 2)
        draw.add_circle_filled(middle, px(13), theme.packed(theme.ACCENT))
        for side in (-1, 1):
            tip = ImVec2(edge + side * px(8), middle.y)
            up, down = ImVec2(edge + side * px(3), middle.y - px(5)), ImVec2(edge + side * px(3), middle.y + px(5))
            draw.add_triangle_filled(tip, up, down, theme.packed(theme.ON_ACCENT))


def draw_sides(names: tuple[str, str], split: float, box: Box, y: float) -> None:
    """Says at each side of the wipe's edge what is seen there. split: 0 … 1; y: upper edge of the labels."""
    edge, gap = box[0] + split * box[2], px(10)
    draw = imgui.get_window_draw_list()
    spans = ((box[0], edge), (edge, box[0] + box[2]))
    for name, (low, high), left in zip(names, spans, (True, False), strict=True):
        with font(None, theme.SMALL):
            shown = elided(name, high - low - 2 * gap - px(24))
        if not shown:
            continue
        draw.push_clip_rect(ImVec2(low, box[1]), ImVec2(high, box[1] + box[3]), True)
        chip(shown, high - gap - chip_size(shown)[0] if left else low + gap, y)
        draw.pop_clip_rect()


def wipe_edge_hovered(app: App, box: Box) -> bool:
    """Whether the mouse is on the wipe's edge."""
    if not app.comparison.against or app.comparison.how != "wipe":
        return False
    return abs(imgui.get_io().mouse_pos.x - (box[0] + app.comparison.split * box[2])) < px(9)


class Screen:
    """Projects grid points to window units."""

    def __init__(self, app: App, box: Box) -> None:
        camera = app.viewport.camera
        assert camera is not None
        self.camera, self.box = camera, box
        self.scale = 1.0 / app.viewport.pixels_per_unit

    def points(self, grid: np.ndarray) -> tuple[list[ImVec2], np.ndarray]:
        pixels, before = project(self.camera, grid)
        corner = np.array(self.box[:2])
        return [ImVec2(*(float(v) for v in corner + self.scale * p)) for p in pixels], before

    def lines(self, grid: np.ndarray, edges, colour: int, width: float) -> None:
        if any(self.camera.distortion):  # a lens bends them
            grid, edges = _in_pieces(grid, edges)
        points, before = self.points(grid)
        draw = imgui.get_window_draw_list()
        for a, b in edges:
            if before[a] and before[b]:
                draw.add_line(points[a], points[b], colour, width)


def _in_pieces(grid: np.ndarray, edges) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Points and edges of the same lines, each cut into LENS_PIECES."""
    share = np.linspace(0.0, 1.0, LENS_PIECES + 1)[:, None]
    points = np.concatenate([(1 - share) * grid[a] + share * grid[b] for a, b in edges])
    starts = [line * (LENS_PIECES + 1) + i for line in range(len(edges)) for i in range(LENS_PIECES)]
    return points, [(start, start + 1) for start in starts]


def draw_crop(app: App, box: Box) -> int | None:
    """The crop box with a handle on each face; the face whose handle is under the mouse, if any."""
    if app.settings.crop is None or app.scene is None or not app.interface.shows("crop"):
        return None
    screen, mouse = Screen(app, box), imgui.get_io().mouse_pos
    low, high = np.asarray(app.settings.crop[0]), np.asarray(app.settings.crop[1])
    corners = box_points(low, high)
    screen.lines(corners, BOX_EDGES, theme.packed(theme.BASE, 0.5), px(3))
    screen.lines(corners, BOX_EDGES, theme.packed(theme.ACCENT), px(1.5))
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


def draw_path(app: App, box: Box) -> None:
    """The camera path and its keyframes, while its page is open and it is not being played."""
    filming = app.filming
    if not app.interface.shows("film") or filming.playing or app.scene is None or not filming.path.keyframes:
        return
    screen, path = Screen(app, box), filming.path
    if len(path.keyframes) > 1:
        count = PATH_STEPS * len(path.keyframes)
        track = path.places(path.duration * np.arange(count + 1) / count)
        screen.lines(track, [(i, i + 1) for i in range(count)], theme.packed(theme.ACCENT), px(2))
    depth = 0.05 if app.scene.rig.bounded else 0.12 * app.scene.rig.radius
    for i, key in enumerate(path.keyframes):
        colour = theme.packed(theme.WARN if i == filming.selected else theme.ACCENT)
        camera = view_camera(key.grid_T_camera, key.fov, filming.size)
        screen.lines(frustum_points(camera, depth), FRUSTUM_EDGES, colour, px(1.5))
