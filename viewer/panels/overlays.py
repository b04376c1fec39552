"""What is drawn over the picture: packs side by side, crop box, camera path, axes, legends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from imgui_bundle import ImVec2, imgui

from viewer.app import crop
from viewer.app.application import App
from viewer.app.frame import other_layers
from viewer.app.pose import BOX_EDGES, FRUSTUM_EDGES, box_points, frustum_points, project, view_camera
from viewer.panels import theme
from viewer.panels.widgets import chip, chip_size, coloured, elided, font, px
from viewer.rendering.canvas import Canvas
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.shader_source import colour_stops
from viewer.rendering.targets import Layer

WIDTH, MARGIN = 372.0, 16.0


@contextmanager
def corner_card(name: str, box: Box) -> Iterator[None]:
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


# --- Over the picture ---

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


# --- The axes of the grid frame in a corner of the picture: a click looks along one, a drag orbits ---

RADIUS, AXES_MARGIN, BALL = 36.0, 14.0, 9.5  # of the gizmo, from the picture's edges, of an axis's end; units at 100 %
LEAST_ROOM = 260.0  # a picture that is smaller has none for it
CLICK = 4.0  # a drag is longer
NAMES = "XYZ"
ON_BALL = "#10151c"


class AxisGizmo:
    """travelled: units since the mouse went down on it."""

    def __init__(self) -> None:
        self._travelled = 0.0

    def show(self, app: App, box: Box) -> None:
        """Draws it in the upper right corner of the picture's box and does what the mouse asks for. Before whatever else
        listens to the mouse there.
        """
        camera, scene = app.viewport.camera, app.scene
        if scene is None or camera is None or scene.rig.bounded or not app.interface.axes_shown:
            return
        if min(box[2], box[3]) < px(LEAST_ROOM):
            return
        radius = px(RADIUS)
        middle = np.array(
            [box[0] + box[2] - px(AXES_MARGIN) - radius - px(BALL), box[1] + px(AXES_MARGIN) + radius + px(BALL)]
        )
        reach = radius + px(BALL)
        imgui.set_cursor_screen_pos(ImVec2(*(float(v) for v in middle - reach)))
        imgui.invisible_button("##axes", ImVec2(2 * reach, 2 * reach))
        hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
        ends = axis_ends(camera.grid_T_camera[:3, :3])
        io = imgui.get_io()
        places = middle + radius * ends[:, :2]
        under = _under(places, ends[:, 2], np.array([io.mouse_pos.x, io.mouse_pos.y])) if hovered else None
        self._listen(app, box, under)
        if hovered or active:
            disc = ImVec2(float(middle[0]), float(middle[1]))
            imgui.get_window_draw_list().add_circle_filled(disc, reach, theme.packed(theme.BASE, 0.55))
        _draw_axes(middle, places, ends[:, 2], under, hovered or active)
        imgui.set_cursor_pos(ImVec2(0, 0))

    def _listen(self, app: App, box: Box, under: int | None) -> None:
        assert app.scene is not None
        rig, io = app.scene.rig, imgui.get_io()
        if imgui.is_item_activated():
            self._travelled = 0.0
            rig.remember()
        elif imgui.is_item_active() and (io.mouse_delta.x or io.mouse_delta.y):
            self._travelled += abs(io.mouse_delta.x) + abs(io.mouse_delta.y)
            if self._travelled >= px(CLICK):
                rig.orbit(io.mouse_delta.x / box[3], io.mouse_delta.y / box[3])
                app.touch()
        if imgui.is_item_deactivated() and self._travelled < px(CLICK) and under is not None:
            rig.look_from(axis_of(under))
            app.touch()


def axis_of(end: int) -> np.ndarray:
    """Unit vector of an axis's end: 0 … 2 for x, y, z, 3 … 5 for the opposite directions; float64 [3], grid frame."""
    return (1.0 if end < 3 else -1.0) * np.eye(3)[end % 3]


def axis_ends(grid_R_camera: np.ndarray) -> np.ndarray:
    """Where the six ends are seen, float64 [6, 3]: x to the right, y down, z towards the viewer."""
    seen = np.stack([axis_of(end) for end in range(6)]) @ grid_R_camera
    return seen * [1.0, -1.0, 1.0]


def _under(places: np.ndarray, depths: np.ndarray, mouse: np.ndarray) -> int | None:
    """The end under the mouse, the foremost where two lie over each other."""
    close = np.linalg.norm(places - mouse, axis=1) <= px(BALL)
    return int(np.argmax(np.where(close, depths, -np.inf))) if close.any() else None


def _draw_axes(middle: np.ndarray, places: np.ndarray, depths: np.ndarray, under: int | None, near: bool) -> None:
    draw = imgui.get_window_draw_list()
    for end in np.argsort(depths):
        place = ImVec2(float(places[end][0]), float(places[end][1]))
        colour, positive = AXIS_COLOURS[end % 3], end < 3
        opacity = 0.65 + 0.35 * float(depths[end] > -0.3)
        if positive:
            draw.add_line(ImVec2(float(middle[0]), float(middle[1])), place, theme.packed(colour, opacity), px(2.5))
        size = px(BALL if positive or near else 0.72 * BALL)
        draw.add_circle_filled(place, size, theme.packed(colour if positive else ON_BALL, opacity if positive else 0.6))
        if not positive:
            draw.add_circle(place, size, theme.packed(colour, opacity), 0, px(1.5))
        if end == under:
            draw.add_circle(place, size + px(1.5), theme.packed("#ffffff"), 0, px(2))
        if positive or end == under:
            name = NAMES[end % 3] if positive else f"-{NAMES[end % 3]}"
            with font(None, theme.SMALL):
                wide = imgui.calc_text_size(name)
                at = ImVec2(place.x - wide.x / 2, place.y - wide.y / 2)
                draw.add_text(at, theme.packed(ON_BALL if positive else "#ffffff"), name)


# --- What the colours of a false-colour picture mean: a bar with numbers and their unit, in the picture's ---

BAR = (200.0, 12.0)  # width, height
LEGEND_PADDING = 12.0
GREY = ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
COUNTED = {"samples": "voxels fetched per ray", "jumps": "jumps per ray"}
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Legend:
    """stops: colours, evenly spaced from left to right. low, middle, high: numbers below the bar. unit: what they count."""

    stops: tuple[Colour, ...]
    low: str
    middle: str
    high: str
    unit: str


def legend_of(app: App) -> Legend | None:
    """The legend_of of the mode that is shown; None where it needs none."""
    camera, mode = app.viewport.camera, app.settings.mode
    if camera is None or app.scene is None:
        return None
    if mode in COUNTED:
        scale = app.settings.cost_scale
        return Legend(colour_stops(), "0", f"{scale / 2:.0f}", f"≥ {scale:.0f}", COUNTED[mode])
    if mode == "depth":
        pack = app.scene.pack
        near, far = RayFrame(pack).depth_range(camera)
        if pack.ndc:
            return Legend(GREY, f"{near:.0f}", f"{(near + far) / 2:.0f}", f"{far:.0f}", "voxels into the warped grid")
        near, far = near * pack.voxel_size, far * pack.voxel_size
        at_least = "≥ " if pack.contraction is not None else ""
        return Legend(
            GREY, f"{near:.3g}", f"{(near + far) / 2:.3g}", f"{at_least}{far:.3g}", "distance, in the grid's units"
        )
    return None


def show_legend(app: App, box: tuple[float, float, float, float]) -> None:
    """Draws it over the picture's box (x, y, width, height; window units), where it has room."""
    told = legend_of(app)
    if told is None:
        return
    draw = imgui.get_window_draw_list()
    with font(None, theme.SMALL):
        line = imgui.get_text_line_height()
        width = min(px(BAR[0]), box[2] - px(28 + 2 * LEGEND_PADDING))
        height = px(BAR[1]) + 2 * line + px(10)
        left, top = box[0] + px(14) + px(LEGEND_PADDING), box[1] + box[3] - px(14) - px(LEGEND_PADDING) - height
        pad = px(LEGEND_PADDING)
        if width < px(90) or top - pad < box[1]:
            return
        low, high = ImVec2(left - pad, top - pad), ImVec2(left + width + pad, top + height + pad)
        draw.add_rect_filled(low, high, theme.packed(theme.BASE, 0.82), px(10))
        draw.add_text(ImVec2(left, top), theme.packed(theme.MUTED), told.unit)
        y = top + line + px(4)
        _bar(draw, told.stops, ImVec2(left, y), width, px(BAR[1]))
        y += px(BAR[1]) + px(4)
        for text, place in ((told.low, 0.0), (told.middle, 0.5), (told.high, 1.0)):
            wide = imgui.calc_text_size(text).x
            draw.add_text(ImVec2(left + place * (width - wide), y), theme.packed(theme.TEXT), text)


def _bar(draw: imgui.ImDrawList, stops: tuple[Colour, ...], corner: ImVec2, width: float, height: float) -> None:
    packed = [imgui.color_convert_float4_to_u32(imgui.ImVec4(*stop, 1.0)) for stop in stops]
    step = width / (len(stops) - 1)
    for i, (a, b) in enumerate(pairwise(packed)):
        low = ImVec2(corner.x + i * step, corner.y)
        draw.add_rect_filled_multi_color(low, ImVec2(low.x + step, corner.y + height), a, b, b, a)
    draw.add_rect(corner, ImVec2(corner.x + width, corner.y + height), theme.packed(theme.LINE))
