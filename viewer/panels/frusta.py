"""The photographs in the scene: frusta with the photographs themselves as their far ends. They can be pointed at.

What is near fades out, and nothing is drawn while a photograph is compared, so that the view stays free.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.app.projection import FRUSTUM_EDGES, project
from viewer.app.thumbnails import Thumbnails
from viewer.panels import theme
from viewer.panels.widgets import coloured, font, px

DEPTH, DEPTH_BOUNDED = 0.16, 0.06  # length of a frustum: of the scene's radius, and in NDC units
FADES_FROM, FADES_TO = 0.22, 0.45  # of the viewport's shorter side: a frustum larger than this is in the way
PICK_RADIUS = 9.0
PREVIEW = 150.0

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class _Frustum:
    """Where one is drawn: float [5, 2] eye and corners in window units, its distance, and how much of it is seen."""

    index: int
    points: np.ndarray
    distance: float
    strength: float


def draw(app: App, canvas: CanvasInterface, box: Box) -> int | None:
    """Draws them; the one under the mouse, if any."""
    gallery = app.gallery
    if not gallery.frusta or gallery.photographs is None or app.scene is None:
        return None
    if app.comparison.against == "photograph":
        return None
    placed = _placed(app, box)
    mouse = np.array([imgui.get_io().mouse_pos.x, imgui.get_io().mouse_pos.y])
    under = next((f for f in reversed(placed) if f.strength > 0.2 and _hit(f.points, mouse)), None)
    if not imgui.is_item_hovered():
        under = None
    sheet = canvas.sheet(gallery.thumbnails) if gallery.thumbnails is not None else None
    chosen = next((f for f in placed if f.index == gallery.chosen), None)
    for frustum in placed:
        if frustum is not under and frustum is not chosen:
            _frustum(app, frustum, sheet, None)
    if chosen is not None and chosen is not under:
        _frustum(app, chosen, sheet, theme.ACCENT)
    if under is not None:
        _frustum(app, under, sheet, theme.TEXT)
        _tooltip(app, under.index, sheet)
    return under.index if under is not None else None


def _placed(app: App, box: Box) -> list[_Frustum]:
    """What of the frusta is to be seen, the farthest first."""
    camera, gallery, scene = app.viewport.camera, app.gallery, app.scene
    assert camera is not None and gallery.photographs is not None and scene is not None
    visible = gallery.visible()
    depth = gallery.frusta_size * (DEPTH_BOUNDED if scene.rig.bounded else DEPTH * scene.rig.radius)
    points = gallery.photographs.frusta(depth)[visible]
    pixels, before = project(camera, points.reshape(-1, 3))
    places = pixels.reshape(-1, 5, 2) / app.viewport.pixels_per_unit + np.array(box[:2])
    before = before.reshape(-1, 5).all(axis=1)
    extent = np.ptp(places, axis=1).max(axis=1) / min(box[2], box[3])
    strength = np.clip((FADES_TO - extent) / (FADES_TO - FADES_FROM), 0.0, 1.0) * before
    distances = np.linalg.norm(points.mean(axis=1) - camera.position, axis=1)
    return [
        _Frustum(visible[i], places[i], float(distances[i]), float(strength[i]))
        for i in np.argsort(-distances)
        if strength[i] > 0.01
    ]


def _hit(points: np.ndarray, mouse: np.ndarray) -> bool:
    """Whether the mouse is on the picture's quadrangle, or at the eye."""
    corners = points[1:]
    sides = np.roll(corners, -1, axis=0) - corners
    to_mouse = mouse - corners
    turns = sides[:, 0] * to_mouse[:, 1] - sides[:, 1] * to_mouse[:, 0]
    inside = bool((turns > 0).all() or (turns < 0).all())
    return inside or float(np.hypot(*(points[0] - mouse))) < px(PICK_RADIUS)


def _frustum(app: App, frustum: _Frustum, sheet: int | None, outline: str | None) -> None:
    gallery, draw_list = app.gallery, imgui.get_window_draw_list()
    assert gallery.photographs is not None
    corners = [ImVec2(float(x), float(y)) for x, y in frustum.points]
    opacity = frustum.strength * (1.0 if outline else gallery.frusta_opacity)
    uv = _uv(gallery.thumbnails, frustum.index)
    if sheet is not None and uv is not None and opacity > 0.01:
        (u0, v0), (u1, v1) = uv
        _, top_left, top_right, low_right, low_left = corners
        uvs = ImVec2(u0, v0), ImVec2(u1, v0), ImVec2(u1, v1), ImVec2(u0, v1)
        texture, tint = imgui.ImTextureRef(sheet), theme.packed("#ffffff", opacity)
        draw_list.add_image_quad(
            texture, top_left, top_right, low_right, low_left, uvs[0], uvs[1], uvs[2], uvs[3], tint
        )
    train = gallery.photographs.shots[frustum.index].split == "train"
    code = outline or (theme.ACCENT_DEEP if train else theme.WARN)
    colour = theme.packed(code, frustum.strength * (1.0 if outline else 0.8))
    if outline:  # on a dark line, to be seen on any background
        for a, b in FRUSTUM_EDGES:
            draw_list.add_line(corners[a], corners[b], theme.packed(theme.BASE, 0.7 * frustum.strength), px(4.5))
    for a, b in FRUSTUM_EDGES:
        draw_list.add_line(corners[a], corners[b], colour, px(2.0 if outline else 1.2))


def _uv(thumbnails: Thumbnails | None, index: int) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Where a shot's picture lies on the sheet, 0 … 1; None where it has none (yet)."""
    place = thumbnails.boxes.get(index) if thumbnails is not None else None
    if thumbnails is None or place is None:
        return None
    height, width = thumbnails.sheet.shape[:2]
    x, y, w, h = place
    return (x / width, y / height), ((x + w) / width, (y + h) / height)


def picture(canvas: CanvasInterface, thumbnails: Thumbnails | None, index: int, low: ImVec2, high: ImVec2) -> bool:
    """Draws a shot's thumbnail in the middle of a rectangle (window units); False where there is none (yet)."""
    uv = _uv(thumbnails, index)
    if thumbnails is None or uv is None:
        return False
    _, _, w, h = thumbnails.boxes[index]
    scale = min((high.x - low.x) / w, (high.y - low.y) / h)
    x, y = 0.5 * (low.x + high.x - scale * w), 0.5 * (low.y + high.y - scale * h)
    corner = ImVec2(x + scale * w, y + scale * h)
    texture = imgui.ImTextureRef(canvas.sheet(thumbnails))
    imgui.get_window_draw_list().add_image_rounded(texture, ImVec2(x, y), corner, *uv, theme.packed("#ffffff"), px(4))
    return True


def _tooltip(app: App, index: int, sheet: int | None) -> None:
    assert app.gallery.photographs is not None
    shot, uv = app.gallery.photographs.shots[index], _uv(app.gallery.thumbnails, index)
    if not imgui.begin_tooltip():
        return
    if sheet is not None and uv is not None and app.gallery.thumbnails is not None:
        _, _, w, h = app.gallery.thumbnails.boxes[index]
        scale = px(PREVIEW) / max(w, h)
        imgui.image(imgui.ImTextureRef(sheet), ImVec2(scale * w, scale * h), *uv)
    imgui.text_unformatted(shot.name)
    with font(None, theme.SMALL), coloured(text=theme.MUTED):
        imgui.text_unformatted(f"{shot.split}   click to go there")
    imgui.end_tooltip()
