"""`snerg-pack export`: a pack as a mesh, points or Gaussians for other programs (docs/commands.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from console import UserError, check_results, progress
from console.arguments import parse_numbers
from scenepack import open_pack
from scenepack.commands import read_with_progress
from scenepack.exports.scene import Export, check_export, export_scene, kind_for


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
) -> None:
    """Writes a pack as a mesh, as points, or as 3D Gaussians for other programs. Colours do not depend on the view.

    Args:
        pack: The pack, a folder or a .zip.
        to: FILE.glb (a mesh), or FILE.ply, whose name (points.ply, mesh.ply, gaussians.ply) or --kind says what it holds.
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
    """
    corners = parse_numbers(crop, 6, "--crop") if crop else None
    box = None if corners is None else ((corners[0], corners[1], corners[2]), (corners[3], corners[4], corners[5]))
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


def _kept(text: str) -> str | float:
    if text in ("all", "largest"):
        return text
    try:
        return float(text)
    except ValueError:
        raise UserError("is not understood", where="--keep", expected="all, largest or a share", found=text) from None
