"""A small software rasteriser, compiled by Numba: meshes and points as a camera of ours sees them, whatever wrote them."""

import numba
import numpy as np

from viewer.rendering.camera import ViewCamera

NEAREST = 1e-6


def project(points: np.ndarray, camera: ViewCamera) -> np.ndarray:
    """Pixels x, y and depth along the axis, float64 [n, 3], of points [n, 3] in the grid frame."""
    camera_T_grid = np.linalg.inv(camera.grid_T_camera)
    p = points @ camera_T_grid[:3, :3].T + camera_T_grid[:3, 3]
    depth = np.maximum(-p[:, 2], NEAREST)
    return np.stack([camera.cx + camera.fx * p[:, 0] / depth, camera.cy - camera.fy * p[:, 1] / depth, -p[:, 2]], 1)


def draw_mesh(
    vertices: np.ndarray, faces: np.ndarray, colours: np.ndarray, camera: ViewCamera
) -> tuple[np.ndarray, np.ndarray]:
    """Picture uint8 [h, w, 3], white where there is nothing, and whether a pixel's centre is covered, bool [h, w].

    vertices float [v, 3]; faces int [f, 3]; colours uint8 [v, 3].
    """
    depth = np.full((camera.height, camera.width), np.inf)
    picture = np.full((camera.height, camera.width, 3), 255.0)
    _fill(project(vertices, camera), np.ascontiguousarray(faces), colours.astype(np.float64), depth, picture)
    return np.rint(picture).astype(np.uint8), np.isfinite(depth)


@numba.njit
def _fill(seen, faces, colours, depth, picture):
    height, width = depth.shape
    for face in faces:
        a, b, c = seen[face[0]], seen[face[1]], seen[face[2]]
        if a[2] <= NEAREST or b[2] <= NEAREST or c[2] <= NEAREST:
            continue
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        left, right = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        top, bottom = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        for y in range(max(0, int(np.ceil(top - 0.5))), min(height - 1, int(np.floor(bottom - 0.5))) + 1):
            for x in range(max(0, int(np.ceil(left - 0.5))), min(width - 1, int(np.floor(right - 0.5))) + 1):
                px, py = x + 0.5, y + 0.5
                u = ((c[0] - b[0]) * (py - b[1]) - (c[1] - b[1]) * (px - b[0])) / area
                v = ((a[0] - c[0]) * (py - c[1]) - (a[1] - c[1]) * (px - c[0])) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                far = 1.0 / (u / a[2] + v / b[2] + w / c[2])
                if far < depth[y, x]:
                    depth[y, x] = far
                    for i in range(3):
                        picture[y, x, i] = far * (
                            u * colours[face[0], i] / a[2]
                            + v * colours[face[1], i] / b[2]
                            + w * colours[face[2], i] / c[2]
                        )


def draw_points(
    points: np.ndarray, colours: np.ndarray, camera: ViewCamera, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """As draw_mesh: each point a square of `radius` grid units to either side, at least a pixel."""
    depth = np.full((camera.height, camera.width), np.inf)
    picture = np.full((camera.height, camera.width, 3), 255, np.uint8)
    _dots(project(points, camera), np.ascontiguousarray(colours), radius * camera.fx, depth, picture)
    return picture, np.isfinite(depth)


@numba.njit
def _dots(seen, colours, size, depth, picture):
    height, width = depth.shape
    for i in range(len(seen)):
        x, y, far = seen[i]
        if far <= NEAREST:
            continue
        r = size / far
        for row in range(max(0, int(np.floor(y - r))), min(height - 1, int(np.floor(y + r))) + 1):
            for column in range(max(0, int(np.floor(x - r))), min(width - 1, int(np.floor(x + r))) + 1):
                if far < depth[row, column]:
                    depth[row, column] = far
                    picture[row, column] = colours[i]


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum() / max((a | b).sum(), 1))


def draw_gaussians(
    points: np.ndarray, sigmas: np.ndarray, opacities: np.ndarray, colours: np.ndarray, camera: ViewCamera
) -> tuple[np.ndarray, np.ndarray]:
    """Picture uint8 [h, w, 3] over white and opacity float [h, w]: round Gaussians splatted front to back, as their paper has it.

    points [n, 3], sigmas [n] in grid units, opacities [n] 0 ... 1, colours [n, 3] 0 ... 1.
    """
    seen = project(points, camera)
    order = np.argsort(seen[:, 2])
    passes = np.ones((camera.height, camera.width))
    colour = np.zeros((camera.height, camera.width, 3))
    _splat(seen[order], sigmas[order] * camera.fx, opacities[order], colours[order], passes, colour)
    picture = np.clip(colour + passes[..., None], 0, 1)
    return np.rint(255 * picture).astype(np.uint8), 1 - passes


@numba.njit
def _splat(seen, sizes, opacities, colours, passes, colour):
    height, width = passes.shape
    for i in range(len(seen)):
        x, y, far = seen[i]
        if far <= NEAREST:
            continue
        variance = (sizes[i] / far) ** 2 + 0.3  # viewers blur by as much
        r = 3.0 * np.sqrt(variance)
        for row in range(max(0, int(np.floor(y - r))), min(height - 1, int(np.floor(y + r))) + 1):
            for column in range(max(0, int(np.floor(x - r))), min(width - 1, int(np.floor(x + r))) + 1):
                off = (column + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2
                a = min(0.99, opacities[i] * np.exp(-0.5 * off / variance))
                if a < 1 / 255:
                    continue
                for k in range(3):
                    colour[row, column, k] += passes[row, column] * a * colours[i, k]
                passes[row, column] *= 1 - a
