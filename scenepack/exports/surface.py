"""The surface where opacity passes a level, by marching cubes (Lewiner et al. 2003, in scikit-image) macroblock by macroblock.

Each cube of neighbouring cells belongs to one box (scenepack.exports.field), so that no part of the surface is made twice and
none is missing. Two boxes see the same values on the face that they share, so the surface runs on without a gap; its vertices
there are joined by where they lie: on one edge between two cells (at most one vertex each), or within one cube. No opacity equals
the level exactly. Memory: a box at a time; of the surface 12 bytes a triangle, and a vertex 12 for its position, 3 for its colour
and 8 for its name until it is joined.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from scenepack.exports.field import Field

WITHIN, EDGES = 3, 4  # a vertex within a cube, beside those on its edges along axes 0 ... 2; kinds of both together
Shared = Callable[[float], None]


@dataclass(frozen=True)
class Surface:
    """vertices float32 [v, 3]: x, y, z in voxels of the pack's grid. faces int32 [f, 3], counter-clockwise from outside in the
    grid's frame. colours uint8 [v, 3]: diffuse, sRGB.
    """

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray

    def without_unused(self) -> Surface:
        """The same without vertices that no face has."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        number = np.cumsum(used, dtype=np.int32) - 1
        return Surface(self.vertices[used], number[self.faces], self.colours[used])

    def only(self, faces: np.ndarray) -> Surface:
        """Some of the faces (bool [f]), and the vertices that they have."""
        return replace(self, faces=self.faces[faces]).without_unused()


def extract(field: Field, level: float, on_progress: Shared = lambda share: None) -> Surface:
    """The surface of `field` where opacity is `level`, 0 ... 1; nothing where there is none."""
    level = (np.floor(255.0 * level) + 0.5) / 255.0  # all opacities are whole 255ths
    names, positions, colours, faces = [], [], [], []
    begun = 0
    for done, (place, box) in enumerate(field.boxes()):
        on_progress(min(done / field.count, 1.0))
        part = _of_box(box, level)
        if part is None:
            continue
        cells, triangles = part
        corner = np.asarray(place) * field.side
        names.append(_names(cells, corner, field))
        rgba = np.stack([map_coordinates(box[..., c], cells.T, order=1, prefilter=False) for c in range(4)], axis=-1)
        straight = rgba[:, :3] / np.maximum(rgba[:, 3:], 1e-6)
        colours.append(np.rint(255.0 * np.clip(straight, 0.0, 1.0)).astype(np.uint8))
        positions.append((field.coarser * (cells + corner + 0.5)).astype(np.float32)[:, ::-1])
        faces.append(triangles + begun)
        begun += len(cells)
    if not faces:
        return Surface(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    _, first, number = np.unique(np.concatenate(names), return_index=True, return_inverse=True)
    joined = number.astype(np.int32)[np.concatenate(faces)]
    return Surface(np.concatenate(positions)[first], joined, np.concatenate(colours)[first])


def _of_box(box: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices float64 [v, 3] (z, y, x in cells of the box) and faces int32 [f, 3]; None where it has no surface."""
    from skimage.measure import marching_cubes

    opacity = box[..., 3]
    if opacity.max() <= level or opacity.min() >= level:
        return None
    vertices, faces, _, _ = marching_cubes(opacity, level, allow_degenerate=True)
    return vertices.astype(np.float64), faces.astype(np.int32)


def _names(cells: np.ndarray, corner: np.ndarray, field: Field) -> np.ndarray:
    """int64 [v]: which edge or cube of the whole grid a vertex lies on. cells [v, 3] in the box at cell `corner`."""
    nearest = np.rint(cells)
    off = np.abs(cells - nearest)
    along = off.argmax(axis=1)
    others = np.take_along_axis(off, np.argsort(off, axis=1)[:, 1:2], axis=1)[:, 0]
    within = others > 1e-5  # more than one coordinate lies between two cells
    base = np.where((np.arange(3) == along[:, None]) | within[:, None], np.floor(cells), nearest).astype(np.int64)
    kind = np.where(within, WITHIN, along)
    # The grid begins a box early: an empty macroblock before the first has cubes, too.
    z, y, x = (base + corner + field.side).T
    rows, columns = (field.side * (n + 2) + 1 for n in field.pack.atlas_indices.shape[1:3])
    return ((z * rows + y) * columns + x) * EDGES + kind
