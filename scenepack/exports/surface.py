"""Surface of a pack: marching cubes and mesh cleanup.

Each cube of neighbouring cells belongs to one box (scenepack.exports.field), so that no part of the surface is made twice and
none is missing. Two boxes see the same values on the face that they share, so the surface runs on without a gap; its vertices
there are joined by where they lie: on one edge between two cells (at most one vertex each), or within one cube. No opacity equals
the level exactly. Sums over faces are taken in parts, and neighbours are stored once, so that memory stays a small multiple of
the mesh's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from scenepack.exports.field import Field, Keep, OnShare, straight_colours

WITHIN, EDGES = 3, 4  # a vertex within a cube, beside those on its edges along axes 0 ... 2; kinds of both together


@dataclass(frozen=True)
class Surface:
    """A mesh with vertex colours."""

    vertices: np.ndarray  # float32 [v, 3]: x, y, z in voxels of the pack's grid
    faces: np.ndarray  # int32 [f, 3], counter-clockwise from outside in the grid's frame
    colours: np.ndarray  # uint8 [v, 3]: diffuse, sRGB

    def only(self, faces: np.ndarray) -> Surface:
        """Some of the faces (bool [f]), and the vertices that they have."""
        kept, used = self.faces[faces], np.zeros(len(self.vertices), bool)
        used[kept] = True
        number = np.cumsum(used, dtype=np.int32) - 1
        return Surface(self.vertices[used], number[kept], self.colours[used])


def extract(field: Field, level: float, on_progress: OnShare = lambda share: None) -> Surface:
    """The surface of `field` where opacity is `level`, 0 ... 1; nothing where there is none."""
    from skimage.measure import marching_cubes

    level = (np.floor(255.0 * level) + 0.5) / 255.0  # all opacities are whole 255ths
    names, positions, colours, faces = [], [], [], []
    begun = 0
    for place, box in field.boxes(on_progress):
        opacity = box[..., 3]
        if opacity.max() <= level or opacity.min() >= level:
            continue
        cells, triangles, _, _ = marching_cubes(opacity, level, allow_degenerate=True)
        cells = cells.astype(np.float64)  # z, y, x in cells of the box
        corner = np.asarray(place) * field.side
        names.append(_names(cells, corner, field))
        rgba = np.stack([map_coordinates(box[..., c], cells.T, order=1, prefilter=False) for c in range(4)], axis=-1)
        colours.append(np.rint(255.0 * straight_colours(rgba)).astype(np.uint8))
        positions.append((field.coarser * (cells + corner + 0.5)).astype(np.float32)[:, ::-1])
        faces.append(triangles.astype(np.int32) + begun)
        begun += len(cells)
    if not faces:
        return Surface(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 3), np.uint8))
    _, first, number = np.unique(np.concatenate(names), return_index=True, return_inverse=True)
    joined = number.astype(np.int32)[np.concatenate(faces)]
    return Surface(np.concatenate(positions)[first], joined, np.concatenate(colours)[first])


def _names(cells: np.ndarray, corner: np.ndarray, field: Field) -> np.ndarray:
    """int64 [v]: which edge or cube of the whole grid a vertex lies on. cells [v, 3] in the box at cell `corner`."""
    nearest = np.rint(cells)
    off = np.abs(cells - nearest)
    along = off.argmax(axis=1)
    within = np.sort(off, axis=1)[:, 1] > 1e-5  # more than one coordinate lies between two cells
    base = np.where((np.arange(3) == along[:, None]) | within[:, None], np.floor(cells), nearest).astype(np.int64)
    kind = np.where(within, WITHIN, along)
    # The grid begins a box early: an empty macroblock before the first has cubes, too.
    z, y, x = (base + corner + field.side).T
    rows, columns = (field.side * (n + 2) + 1 for n in field.pack.atlas_indices.shape[1:3])
    return ((z * rows + y) * columns + x) * EDGES + kind


# --- Mesh cleanup ---

LAMBDA, MU = 0.5, -0.53  # Taubin 1995: a shrinking step and a slightly larger growing step
AT_ONCE = 1 << 20  # faces per part


def without_floaters(surface: Surface, keep: Keep) -> Surface:
    """keep: "all"; "largest", the component of most area; or the least share of the whole area that a component must have."""
    if keep == "all" or not len(surface.faces):
        return surface
    labels = components(surface)
    area = np.bincount(labels, weights=face_areas(surface))
    kept = area == area.max() if keep == "largest" else area >= float(keep) * area.sum()
    return surface.only(kept[labels])


def components(surface: Surface) -> np.ndarray:
    """int32 [f]: the number of the connected component that a face belongs to."""
    first, second, third = surface.faces.T
    rows, columns = np.concatenate([first, second]), np.concatenate([second, third])
    links = coo_matrix((np.ones(len(rows), np.bool_), (rows, columns)), shape=(len(surface.vertices),) * 2)
    return connected_components(links, directed=False)[1][first]


def face_normals(surface: Surface) -> np.ndarray:
    """float64 [f, 3]: normals, twice as long as the face's area."""
    a, b, c = (surface.vertices[surface.faces[:, i]].astype(np.float64) for i in range(3))
    return np.cross(b - a, c - a)


def face_areas(surface: Surface) -> np.ndarray:
    """float64 [f], in units of the vertices squared."""
    return np.concatenate([0.5 * np.linalg.norm(face_normals(part), axis=1) for part in _parts(surface)])


def vertex_normals(surface: Surface) -> np.ndarray:
    """float32 [v, 3]: unit means of the normals around, weighted by area."""
    total = np.zeros((len(surface.vertices), 3))
    for part in _parts(surface):
        normals = face_normals(part)
        for corner, axis in product(range(3), repeat=2):
            total[:, axis] += np.bincount(part.faces[:, corner], normals[:, axis], minlength=len(total))
    return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def smoothed(surface: Surface, times: int) -> Surface:
    """Taubin's smoothing: rough skin goes, the volume stays. Colours stay with their vertices."""
    if not times:
        return surface
    count = len(surface.vertices)
    # On a closed surface each neighbour follows once, in one of the two faces of the edge between.
    rows, columns = surface.faces.ravel(), np.roll(surface.faces, -1, axis=1).ravel()
    follows = coo_matrix((np.ones(len(rows), np.float32), (rows, columns)), shape=(count, count)).tocsr()
    share = 1.0 / np.maximum(np.bincount(rows, minlength=count), 1)[:, None]
    vertices = surface.vertices.astype(np.float64)
    for _ in range(times):
        for step in (LAMBDA, MU):
            vertices += step * (share * (follows @ vertices) - vertices)
    return Surface(vertices.astype(np.float32), surface.faces, surface.colours)


def decimated(surface: Surface, most_faces: int) -> Surface:
    """At most that many faces, by collapsing edges (Garland and Heckbert 1997); a vertex has the colour of the closest before."""
    if len(surface.faces) <= most_faces:
        return surface
    import fast_simplification

    vertices, faces = fast_simplification.simplify(surface.vertices, surface.faces, target_count=most_faces)[:2]
    closest = KDTree(surface.vertices).query(vertices)[1]
    return Surface(vertices.astype(np.float32), faces.astype(np.int32), surface.colours[closest])


def _parts(surface: Surface) -> Iterator[Surface]:
    for start in range(0, len(surface.faces), AT_ONCE):
        yield Surface(surface.vertices, surface.faces[start : start + AT_ONCE], surface.colours)
