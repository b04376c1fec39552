"""Voxels that are seen within an outline drawn over the picture: only what shows there, or all behind it as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from PIL import Image, ImageDraw

from scenepack.editing import Selection, Voxels
from viewer.core.pose import project
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.settings import RenderSettings

REACH = 2.0  # voxels behind the mean depth of a pixel that still show in it

Box = tuple[int, int, int, int]  # x, y, width, height in pixels


def box_around(camera: ViewCamera, outline: np.ndarray) -> Box | None:
    """The pixels of the camera's picture that an outline (pixels, float [m, 2]) may hold; None for none."""
    low = np.clip(np.floor(outline.min(axis=0)), 0, (camera.width, camera.height)).astype(int)
    high = np.clip(np.floor(outline.max(axis=0)) + 1, 0, (camera.width, camera.height)).astype(int)
    x, y, width, height = (int(n) for n in (*low, *(high - low)))
    return (x, y, width, height) if width and height else None


def depth_within(canvas: Canvas, camera: ViewCamera, settings: RenderSettings, box: Box, scale: float) -> np.ndarray:
    """Depth, float32 [h, w], of a part of the picture, drawn at `scale` of its size."""
    x, y, width, height = box
    part = replace(camera, width=width, height=height, cx=camera.cx - x, cy=camera.cy - y)
    return canvas.depth(part.resized(max(1, round(scale * width)), max(1, round(scale * height))), settings)


def seen_within(
    voxels: Voxels,
    camera: ViewCamera,
    settings: RenderSettings,
    outline: np.ndarray,
    box: Box,
    depth: np.ndarray | None,
) -> Selection:
    """Voxels that are seen within `outline` (pixels, float [m, 2], within `box`) and are not cut off.

    depth: of the box, float [h, w]: only voxels that show there. None: those behind them as well.
    """
    x0, y0, width, height = box
    image = Image.new("1", (width, height))
    ImageDraw.Draw(image).polygon([(x - x0, y - y0) for x, y in outline.tolist()], fill=1)
    inside = np.asarray(image)
    low, high = RayFrame(voxels.pack).box(settings)
    camera_T_grid = np.linalg.inv(camera.grid_T_camera)
    near = max(camera.near, settings.near)

    def test(positions: np.ndarray) -> np.ndarray:
        points = voxels.frame.points(positions)
        pixels, before = project(camera, points)
        column, row = np.floor(pixels - (x0, y0)).T
        held = before & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        held &= np.all((positions >= low) & (positions <= high), axis=1)
        some = np.flatnonzero(held)
        column, row = column[some].astype(int), row[some].astype(int)
        away = -(points[some] @ camera_T_grid[2, :3] + camera_T_grid[2, 3])
        chosen = inside[row, column] & (away >= near)
        if depth is not None:
            h, w = depth.shape
            shown = depth[row * h // height, column * w // width]
            reach = REACH * voxels.frame.sizes(positions[some]).max(axis=1)
            chosen &= (shown > 0) & (away <= shown + reach)
        held[some] = chosen
        return held

    return voxels.where(test, _may_be_seen(voxels, camera, box))


def _may_be_seen(voxels: Voxels, camera: ViewCamera, box: Box) -> np.ndarray | None:
    """bool [n]: macroblocks that reach into the pyramid of rays through a box; None, for all, where a lens bends the rays."""
    if any(camera.distortion):
        return None
    x, y, width, height = box
    left, right = ((end - camera.cx) / camera.fx for end in (x, x + width))
    top, foot = ((camera.cy - end) / camera.fy for end in (y, y + height))
    if camera.orthographic:
        planes = [(1, 0, 0, -left), (-1, 0, 0, right), (0, 1, 0, -foot), (0, -1, 0, top)]
    else:
        planes = [(1, 0, left, 0), (-1, 0, -right, 0), (0, 1, foot, 0), (0, -1, -top, 0)]
    inwards = np.array([*planes, (0, 0, -1, 0)], float) @ np.linalg.inv(camera.grid_T_camera)
    first, last = voxels.boxes
    centre, half = 0.5 * (first + last), 0.5 * (last - first)
    return np.all(centre @ inwards[:, :3].T + half @ np.abs(inwards[:, :3]).T + inwards[:, 3] >= 0, axis=1)
