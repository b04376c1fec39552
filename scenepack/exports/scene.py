"""A pack as a file for other programs: what to write, and writing it in one step (docs/commands.md, "snerg-pack")."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from tyro.conf import Suppress

from console import UserError, write_result
from console.command_line import require_in_range
from scenepack.exports import file_formats
from scenepack.exports.field import Corners, ExportFrame, Field, Frame, Keep, straight_colours
from scenepack.exports.file_formats import Geometry
from scenepack.exports.surface import (
    Surface,
    decimated,
    extract,
    face_areas,
    smoothed,
    vertex_normals,
    without_floaters,
)
from scenepack.pack import Pack

Kind = Literal["points", "mesh", "gaussians"]
KINDS: tuple[Kind, ...] = get_args(Kind)
ONLY: dict[str, Kind] = {".glb": "mesh", ".spz": "gaussians"}  # what a suffix alone may hold
SUFFIXES = (".ply", *ONLY)
LEAST_OPACITY = 0.02  # of a voxel that becomes a Gaussian
MOST_FACES, MOST_GAUSSIANS = 16_000_000, 6_000_000  # made before anything is thinned: 3 GB and 2 GB at their peak
MOST_POINTS = 50_000_000
NO_FACES = np.zeros((0, 3), np.int32)
FACES_A_CROSSING = 6.0  # of a surface, triangles for each time that a row along x passes through it
OnProgress = Callable[[float, str], None]


@dataclass(frozen=True)
class Export:
    """What is written, as options of snerg-pack."""

    kind: Kind | None = None
    """points, mesh or gaussians."""
    level: float = 0.15
    """Opacity of the surface of points and meshes. Lower includes thinner mist."""
    coarser: int | None = None
    """Merge this many voxels along each side. The default is 1, or what memory allows."""
    keep: Keep = 0.001
    """Which connected parts of the surface: all, largest, or those with at least this share of its area."""
    smooth: int = 5
    """Steps of smoothing (Taubin). 0 keeps the steps of voxels."""
    faces: int = 500_000
    """About so many triangles at most; 0 for all."""
    spacing: float = 1.0
    """Mean distance of points, in voxels."""
    frame: Frame = "placed"
    """placed (y up: the grid frame, or as it was moved in the viewer, in its unit), grid (y up), or world (that of the poses)."""
    scale: float = 1.0
    """Multiply all lengths by this."""
    crop: Suppress[Corners | None] = None
    """Corners (min, max) of a box in the grid frame; nothing outside of it is written."""


@dataclass(frozen=True)
class Written:
    """How much a file holds: points or Gaussians, triangles (0 but in meshes), voxels a side that became one."""

    points: int
    faces: int
    coarser: int


def kind_for(file: Path, kind: Kind | None) -> Kind:
    """What to write into `file`: as chosen, or as its name says. UserError where that is no kind of this file."""
    suffix, stem = file.suffix.lower(), file.stem.lower()
    if suffix not in SUFFIXES:
        raise UserError("is not a supported file type", where=file, expected="FILE.ply, FILE.glb or FILE.spz")
    if only := ONLY.get(suffix):
        if kind not in (None, only):
            expected = "a mesh" if only == "mesh" else only
            raise UserError(f"cannot hold {kind}", where=file, expected=expected, remedy="name a .ply")
        return only
    named: list[Kind] = [each for each in KINDS if each.rstrip("s") in stem]
    if kind is None and len(named) != 1:
        raise UserError("may be points, a mesh or gaussians", where=file, remedy="add --kind points, mesh or gaussians")
    return kind or named[0]


def check_export(export: Export, pack: Pack | None = None) -> None:
    """UserError where a number makes no sense or does not suit the pack, or a library is not installed."""
    libraries = ("skimage", "fast_simplification") if export.kind != "gaussians" else ()
    if not all(map(importlib.util.find_spec, libraries)):
        raise UserError("a mesh or points need scikit-image", remedy="pip install 'snerg[export]'")
    for name, value, low, high in (
        ("--level", export.level, 0.004, 0.99),
        ("--smooth", export.smooth, 0, 1000),
        ("--spacing", export.spacing, 0.05, 1000),
        ("--scale", export.scale, 1e-9, 1e9),
        ("--faces", export.faces or None, 100, 1 << 30),
        ("--keep", export.keep if isinstance(export.keep, float) else None, 0, 1),
    ):
        require_in_range(name, value, low, high)
    if pack is not None and export.coarser is not None and export.coarser not in divisors(pack.block_size):
        expected = ", ".join(map(str, divisors(pack.block_size)))
        raise UserError("does not divide a macroblock", where="--coarser", expected=expected, found=export.coarser)


def divisors(number: int) -> list[int]:
    return [i for i in range(1, number + 1) if number % i == 0]


def export_scene(pack: Pack, file: Path, export: Export, on_progress: OnProgress = lambda share, note: None) -> Written:
    """Writes `file` in one step. on_progress: called with the share that is done and what is being done.

    UserError where nothing would be in it, or it cannot be written.
    """
    if export.kind == "gaussians":
        field, export_frame = _field(pack, export, on_progress), ExportFrame(pack, export.frame, export.scale)
        positions, rgba = _gaussian_voxels(field, export, export_frame)
        on_progress(0.5, f"{len(positions):,} Gaussians")
        values = file_formats.gaussian_values(positions, rgba, field, export_frame)
        written = Written(len(positions), 0, field.coarser)
        is_spz = file.suffix.lower() == ".spz"
        parts = [file_formats.spz_bytes(values)] if is_spz else file_formats.ply_parts(file_formats.COLUMNS, values)
    else:
        geometry = geometry_of(pack, export, on_progress)
        said = [f"frame {export.frame}, lengths times {export.scale:g}", "colours are diffuse, sRGB"]
        parts = geometry.file_parts(file, said)
        written = Written(len(geometry.vertices), len(geometry.faces), geometry.coarser)
    on_progress(0.95, "writing")
    write_result(file, parts)
    on_progress(1.0, "")
    return written


def _field(pack: Pack, export: Export, on_progress: OnProgress) -> Field:
    check_export(export, pack)
    on_progress(0.0, "counting")
    return Field(pack, export.coarser or _coarseness(Field(pack, 1, export.crop), export), export.crop)


def _coarseness(field: Field, export: Export) -> int:
    """The fewest voxels a side that must become one for the work to stay within bounds."""
    opacities = (field.block(place)[..., 3] for place in field.occupied)
    if export.kind == "gaussians":
        amount, most, power = sum(int(np.sum(each >= LEAST_OPACITY)) for each in opacities), MOST_GAUSSIANS, 3
    else:
        crossings = sum(int(np.sum(np.diff(each > export.level, axis=2))) for each in opacities)
        amount, most, power = FACES_A_CROSSING * crossings, MOST_FACES, 2
    return next((f for f in divisors(field.pack.block_size) if amount <= most * f**power), field.pack.block_size)


def _gaussian_voxels(field: Field, export: Export, export_frame: ExportFrame) -> tuple[np.ndarray, np.ndarray]:
    """Positions and rgba of file_formats.voxels_of that become Gaussians. UserError where there are none."""
    positions, rgba = file_formats.voxels_of(field, LEAST_OPACITY)
    near = export_frame.near_enough(positions)
    require_some(int(near.sum()), export)
    return positions[near], rgba[near]


def geometry_of(pack: Pack, export: Export, on_progress: OnProgress = lambda share, note: None) -> Geometry:
    """The points or the mesh (export.kind) of a pack, or the middles of its Gaussians. UserError where there would be none."""
    field, export_frame = _field(pack, export, on_progress), ExportFrame(pack, export.frame, export.scale)
    if export.kind == "gaussians":
        positions, rgba = _gaussian_voxels(field, export, export_frame)
        points = export_frame.points(positions).astype(np.float32)
        colours = np.rint(255.0 * straight_colours(rgba)).astype(np.uint8)
        return Geometry(points, np.zeros_like(points), colours, NO_FACES, field.coarser)
    surface = extract(field, export.level, lambda share: on_progress(0.6 * share, "finding the surface"))
    on_progress(0.6, "removing floaters")
    surface = without_floaters(surface, export.keep)
    near = export_frame.near_enough(surface.vertices)
    if export.kind == "mesh":
        near &= export_frame.in_inner_cube(surface.vertices)
    if not near.all():
        surface = surface.only(np.all(near[surface.faces], axis=1))
    require_some(len(surface.faces), export)
    on_progress(0.7, "smoothing")
    surface = smoothed(surface, export.smooth)
    if export.kind == "points":
        return Geometry(*scattered(surface, export, export_frame), NO_FACES, field.coarser)
    if export.faces:
        on_progress(0.8, "removing triangles")
        surface = decimated(surface, export.faces)
    on_progress(0.9, f"{len(surface.faces):,} triangles")
    surface = placed(surface, export_frame)
    arrays = (surface.vertices, vertex_normals(surface), surface.colours, surface.faces)
    return Geometry(*arrays, field.coarser, file_formats.gltf_cameras(pack, export_frame))


def placed(surface: Surface, export_frame: ExportFrame) -> Surface:
    """The surface in the frame in which the file shall be; faces are counter-clockwise from outside there, too."""
    faces = surface.faces[:, ::-1] if export_frame.mirrors else surface.faces
    return Surface(export_frame.points(surface.vertices).astype(np.float32), faces, surface.colours)


def scattered(surface: Surface, export: Export, export_frame: ExportFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points float32, normals float32 and colours uint8, [n, 3] each: evenly by area, one to a square of `spacing` voxels."""
    sums = np.cumsum(face_areas(surface)) / export.spacing**2
    count = max(int(sums[-1]), 1)
    if count > MOST_POINTS:
        raise UserError(f"{count:,} points are too many", where="--spacing", expected=f"at most {MOST_POINTS:,}",
                        remedy="choose a larger one")  # fmt: skip
    rng = np.random.default_rng(0)
    chosen = np.minimum(np.searchsorted(sums, np.arange(count) + rng.random(count)), len(sums) - 1)
    weights = rng.random((2, count))
    u, v = np.where(weights.sum(axis=0) > 1, 1 - weights, weights)
    weights = np.stack([1 - (u + v), u, v], axis=1)[..., None]  # barycentric
    corners = surface.faces[chosen]
    there = placed(surface, export_frame)
    points = (there.vertices[corners] * weights).sum(axis=1)
    normals = (vertex_normals(there)[corners] * weights).sum(axis=1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    colours = np.rint((surface.colours[corners] * weights).sum(axis=1)).astype(np.uint8)
    return points.astype(np.float32), normals.astype(np.float32), colours


def require_some(count: int, export: Export) -> None:
    if not count:
        where = "--crop" if export.crop is not None else None
        raise UserError("there is nothing to export", where=where, remedy="choose a larger box or a lower --level")


# --- Preview: the geometry of an export in voxels so coarse that it takes a second or two; nothing is written ---

MOST_CELLS = 256  # along the longest side of the grid


def preview_geometry(pack: Pack, export: Export, on_progress: OnProgress = lambda share, note: None) -> Geometry:
    """The geometry that `export` would write, in the grid frame. on_progress: as for export_scene; may raise.

    UserError if it would be empty.
    """
    check_export(export, pack)
    coarser = export.coarser or coarseness(pack)
    spacing = float(coarser if export.kind == "gaussians" else max(export.spacing, coarser))
    smooth = -(-export.smooth // coarser)  # smooths about as far
    alike = replace(export, coarser=coarser, smooth=smooth, spacing=spacing, frame="grid", scale=1.0)
    return replace(geometry_of(pack, alike, on_progress), point_size=spacing * pack.voxel_size)


def coarseness(pack: Pack) -> int:
    """The fewest voxels per side that must be merged for a preview."""
    longest = max(pack.grid_size)
    return next((f for f in divisors(pack.block_size) if longest <= MOST_CELLS * f), pack.block_size)
