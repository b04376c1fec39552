"""Export preview: the geometry of an export, in voxels so coarse that it takes a second or two. Nothing is written."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from scenepack.exports.field import ExportFrame, Field
from scenepack.exports.file_formats import voxels_of
from scenepack.exports.scene import (
    LEAST_OPACITY,
    Export,
    OnProgress,
    check_export,
    divisors,
    placed,
    require_some,
    scattered,
    surface_of,
)
from scenepack.exports.surface import decimated, vertex_normals
from scenepack.pack import Pack

MOST_CELLS = 256  # along the longest side of the grid


@dataclass(frozen=True, eq=False)
class PreviewGeometry:
    """Triangles or points of an export, in the grid frame (y up; in forward-facing packs before the warp)."""

    vertices: np.ndarray  # float32 [v, 3]
    normals: np.ndarray  # float32 [v, 3]; zero if unknown
    colours: np.ndarray  # uint8 [v, 3], sRGB
    faces: np.ndarray  # int32 [f, 3]; empty: the vertices are points
    size: float  # of a point, grid units
    coarser: int  # voxels per side that were merged into one


def preview_geometry(pack: Pack, export: Export, on_progress: OnProgress = lambda share, note: None) -> PreviewGeometry:
    """The geometry that `export` would write, in the grid frame. on_progress: as for export_scene; may raise.

    UserError if it would be empty.
    """
    check_export(export, pack)
    export_frame = ExportFrame(pack)
    coarser = export.coarser or coarseness(pack)
    field = Field(pack, coarser, export.crop)
    no_faces = np.zeros((0, 3), np.int32)
    if export.kind == "gaussians":
        positions, rgba = voxels_of(field, LEAST_OPACITY)
        near = export_frame.near_enough(positions)
        positions, rgba = positions[near], rgba[near]
        require_some(len(positions), export)
        straight = np.clip(rgba[:, :3] / np.maximum(rgba[:, 3:], 1e-6), 0.0, 1.0)
        points = export_frame.points(positions).astype(np.float32)
        colours = np.rint(255.0 * straight).astype(np.uint8)
        return PreviewGeometry(points, np.zeros_like(points), colours, no_faces, coarser * pack.voxel_size, coarser)
    alike = replace(export, smooth=-(-export.smooth // coarser))  # smooths about as far
    surface = surface_of(field, alike, export_frame, on_progress)
    if export.kind == "points":
        spacing = max(export.spacing, float(coarser))
        points, normals, colours = scattered(surface, replace(export, spacing=spacing), export_frame)
        return PreviewGeometry(
            points.astype(np.float32), normals.astype(np.float32), colours, no_faces, spacing * pack.voxel_size, coarser
        )
    if export.faces is not None:
        on_progress(0.8, "removing triangles")
        surface = decimated(surface, export.faces)
    there = placed(surface, export_frame)
    return PreviewGeometry(there.vertices, vertex_normals(there), there.colours, there.faces, 0.0, coarser)


def coarseness(pack: Pack) -> int:
    """The fewest voxels per side that must be merged for a preview."""
    longest = max(pack.grid_size)
    return next((f for f in divisors(pack.block_size) if longest <= MOST_CELLS * f), pack.block_size)
