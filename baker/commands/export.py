"""`snerg-pack export`: a pack as a mesh, points or Gaussians for other programs, or as a web page (docs/commands.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from console import UserError, check_results, not_written, progress
from console.arguments import parse_numbers
from console.atomic import write_file
from scenepack import open_pack
from scenepack.commands import read_with_progress
from scenepack.exports.field import Corners
from scenepack.exports.scene import Export, check_export, export_scene, kind_for
from viewer.web.page import PageContent, path_from_file, scene_page

PAGE_SUFFIXES = (".html", ".htm")


def export(
    pack: Path,
    /,
    to: Path,
    kind: Literal["points", "mesh", "gaussians"] | None = None,
    level: float = 0.15,
    coarser: int | None = None,
    keep: str = "0.001",
    smooth: int = 5,
    faces: int = 500_000,
    spacing: float = 1.0,
    frame: Literal["grid", "world"] = "grid",
    scale: float = 1.0,
    crop: str | None = None,
    title: str | None = None,
    path: Path | None = None,
) -> None:
    """Writes a pack as one web page that shows it as the viewer does; or as a mesh, as points, or as 3D Gaussians for other
    programs, whose colours do not depend on the view.

    Args:
        pack: The pack, a folder or a .zip.
        to: FILE.html (a web page), FILE.glb (a mesh), or FILE.ply, whose name (points.ply, mesh.ply, gaussians.ply) or --kind
            says what it holds.
        kind: points, mesh or gaussians.
        level: Opacity of the surface of points and meshes. Lower includes thinner mist.
        coarser: Merge this many voxels along each side. The default is 1, or what memory allows.
        keep: Which connected parts of the surface: all, largest, or those with at least this share of its area.
        smooth: Steps of smoothing (Taubin). 0 keeps the steps of voxels.
        faces: About so many triangles at most; 0 for all.
        spacing: Mean distance of points, in voxels.
        frame: grid (y up), or world (the frame of the photographs' poses).
        scale: Multiply all lengths by this.
        crop: Only what is in the box x0,y0,z0,x1,y1,z1 of the grid frame.
        title: Heading of a web page. The default is the pack's name.
        path: Camera path that a web page plays, as the viewer or nerfstudio saves it (JSON).
    """
    corners = parse_numbers(crop, 6, "--crop") if crop else None
    box = None if corners is None else ((corners[0], corners[1], corners[2]), (corners[3], corners[4], corners[5]))
    if to.suffix.lower() in PAGE_SUFFIXES:
        if kind is not None:
            raise UserError(f"cannot hold {kind}", where=to, expected="a web page", remedy="leave out --kind")
        _export_page(pack, to, title, path, box)
        return
    if title is not None or path is not None:
        raise UserError("has no title and no camera path", where=to, expected="FILE.html for --title and --path")
    wanted = Export(kind_for(to, kind), level, coarser, _kept(keep), smooth, faces or None, spacing, frame, scale, box)
    check_export(wanted)
    check_results(to)
    with open_pack(pack) as reader:
        loaded = read_with_progress(reader)
    with progress("exporting", 1) as bar:
        written = export_scene(loaded, to, wanted, lambda share, note: bar.update(share, note))
    amount = f"{written.faces:,} triangles" if written.faces else f"{written.points:,} {wanted.kind}"
    merged = "" if written.coarser == 1 else f", {written.coarser}³ voxels merged into one"
    print(f"{to}: {amount}{merged}, {to.stat().st_size / 1e6:.2f} MB")


def _export_page(pack: Path, to: Path, title: str | None, path: Path | None, crop: Corners | None) -> None:
    check_results(to)
    with open_pack(pack) as reader:
        loaded = read_with_progress(reader)
    flight = None if path is None else path_from_file(path, loaded)
    content = PageContent(title or pack.resolve().stem, flight, crop)
    with progress("exporting", 1) as bar:
        page = scene_page(loaded, content, bar.update)
    try:
        write_file(to, page)
    except OSError as error:
        words, remedy = not_written(error)
        raise UserError(words, where=to, remedy=remedy) from error
    print(f"{to}: a web page, {len(page) / 1e6:.2f} MB")


def _kept(text: str) -> str | float:
    if text in ("all", "largest"):
        return text
    try:
        return float(text)
    except ValueError:
        raise UserError("is not understood", where="--keep", expected="all, largest or a share", found=text) from None
