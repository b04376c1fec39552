"""Mesh cleanup: remove small components, smooth (Taubin), decimate.

Sums over faces are taken in parts, and neighbours are stored once, so that memory stays a small multiple of the mesh's.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scenepack.exports.surface import Surface

LAMBDA, MU = 0.5, -0.53  # Taubin 1995: a shrinking step and a slightly larger growing step
AT_ONCE = 1 << 20  # faces per part
FLATTEST = 1e-3  # of the largest eigenvalue; along smaller ones the mean is used


def without_floaters(surface: Surface, keep: str | float) -> Surface:
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
    count = len(surface.vertices)
    rows, columns = np.concatenate([first, second]), np.concatenate([second, third])
    links = coo_matrix((np.ones(len(rows), np.bool_), (rows, columns)), shape=(count, count))
    _, of_vertex = connected_components(links, directed=False)
    return of_vertex[first]


def face_normals(surface: Surface) -> np.ndarray:
    """float64 [f, 3]: normals, twice as long as the face's area."""
    a, b, c = (surface.vertices[surface.faces[:, i]].astype(np.float64) for i in range(3))
    return np.cross(b - a, c - a)


def face_areas(surface: Surface) -> np.ndarray:
    """float64 [f], in units of the vertices squared."""
    parts = [
        0.5 * np.linalg.norm(face_normals(_some(surface, start)), axis=1)
        for start in range(0, len(surface.faces), AT_ONCE)
    ]
    return np.concatenate(parts) if parts else np.zeros(0)


def vertex_normals(surface: Surface) -> np.ndarray:
    """float32 [v, 3]: unit means of the normals around, weighted by area."""
    total = np.zeros((len(surface.vertices), 3))
    for start in range(0, len(surface.faces), AT_ONCE):
        part = _some(surface, start)
        normals = face_normals(part)
        for i in range(3):
            _add(total, part.faces[:, i], normals)
    return (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)).astype(np.float32)


def smoothed(surface: Surface, times: int) -> Surface:
    """Taubin's smoothing: rough skin goes, the volume stays. Colours stay with their vertices."""
    if not times or not len(surface.faces):
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
    """At most about that many faces: by the finest of a few clusterings that gives no more."""
    side = 1.0
    while len(surface.faces) > most_faces:
        # Of a smooth surface a cluster keeps two faces for each square of its side.
        side *= max(np.sqrt(len(surface.faces) / most_faces), 1.05)
        surface = clustered(surface, side)
    return surface


def clustered(surface: Surface, side: float) -> Surface:
    """One vertex for each cube of `side` voxels, where it is closest to the planes of the faces that were around.

    Source: Lindstrom, "Out-of-core simplification of large polygonal models" (2000): the sum of the squared distances to the
    planes of all faces of a cluster's vertices, weighted by area squared; where eigenvalues are small, the mean decides instead.
    """
    cells = np.floor((surface.vertices - surface.vertices.min(axis=0)) / side).astype(np.int64)
    shape = cells.max(axis=0) + 1
    names = (cells[:, 0] * shape[1] + cells[:, 1]) * shape[2] + cells[:, 2]
    _, cluster = np.unique(names, return_inverse=True)
    count = int(cluster.max()) + 1
    members = np.bincount(cluster, minlength=count)[:, None]
    mean, colour = np.zeros((count, 3)), np.zeros((count, 3))
    _add(mean, cluster, surface.vertices)
    _add(colour, cluster, surface.colours)
    mean, colour = mean / members, colour / members
    best = mean + _towards_planes(surface, cluster, mean, side)
    faces = cluster[surface.faces].astype(np.int32)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return Surface(best.astype(np.float32), faces[np.sort(first)], np.rint(colour).astype(np.uint8)).without_unused()


def _towards_planes(surface: Surface, cluster: np.ndarray, mean: np.ndarray, side: float) -> np.ndarray:
    """float64 [clusters, 3]: from a cluster's mean to the point that its quadric asks for, at most half a side along an axis."""
    matrix, right = np.zeros((len(mean), 9)), np.zeros((len(mean), 3))
    for start in range(0, len(surface.faces), AT_ONCE):
        part = _some(surface, start)
        normals = face_normals(part)
        for i in range(3):
            owner = cluster[part.faces[:, i]]
            offset = np.sum(normals * (part.vertices[part.faces[:, 0]] - mean[owner]), axis=1)
            _add(matrix, owner, (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9))
            _add(right, owner, normals * offset[:, None])
    values, vectors = np.linalg.eigh(matrix.reshape(-1, 3, 3))
    kept = values > FLATTEST * np.maximum(values[:, 2:], 1e-30)
    inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    along = np.einsum("nij,ni->nj", vectors, right) * inverse
    return np.clip(np.einsum("nij,nj->ni", vectors, along), -0.5 * side, 0.5 * side)


def _some(surface: Surface, start: int) -> Surface:
    return Surface(surface.vertices, surface.faces[start : start + AT_ONCE], surface.colours)


def _add(total: np.ndarray, rows: np.ndarray, values: np.ndarray) -> None:
    """total[rows] += values, repeated rows counted."""
    for column in range(total.shape[1]):
        total[:, column] += np.bincount(rows, weights=values[:, column], minlength=len(total))
