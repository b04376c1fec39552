"""`snerg-pack info|check|convert|edit|move|export|compare`: all about packs (docs/commands.md). Nothing here needs JAX."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console

from console import UserError, check_results, progress, run_command, write_json, write_result
from console.command_line import parse_crop, parse_numbers, parse_point, parse_size, require_in_range
from console.streams import one_line
from scenepack import Pack, PackReader, check_pack, check_target, open_pack, save_pack
from scenepack.codecs import chosen_quality, codec_named
from scenepack.editing import NOTHING, EditPreview, Selection, Voxels, without
from scenepack.exports.scene import Export, check_export, export_scene, kind_for
from scenepack.files import stored_bytes
from scenepack.pack import MOST_LENGTH
from scenepack.piece_files import SETTINGS
from scenepack.placement import (
    MARKS,
    SCALES,
    UNITS,
    Placement,
    ground_plane,
    placed_T_grid,
    placement_of,
    placement_to_json,
)
from scenepack.report import pack_facts, print_facts, print_findings
from scenepack.writer import copy_pack
from viewer.web.description import PageContent, with_annotations
from viewer.web.page import INDEX, scene_files, scene_page

DESCRIPTION = (
    "Inspects, checks, converts, edits, moves, exports and compares packs "
    "(baked scenes: a folder with scene_params.json, or one .zip)."
)
PAGE_SUFFIXES = (".html", ".htm")
SHORTEST_DIRECTION = 1e-6  # length of --up
MOST_TURN = 1e6  # degrees


def info(pack: Path, /, json: Path | None = None) -> None:
    """Prints what a pack contains: sizes, occupancy, storage, frame, view MLP, provenance.

    Args:
        pack: The pack, a folder or a .zip.
        json: Also write the figures to this file, sizes in voxels and bytes; "-" prints them instead of the text.
    """
    check_results(json)
    with open_pack(pack) as reader:
        facts = pack_facts(reader.files, _read_all(reader))
    if not write_json(json, facts):
        print_facts(facts, Console())


def check(pack: Path, /, json: Path | None = None, strict: bool = False) -> None:
    """Validates a pack: index bounds, padding, premultiplied colours, shared or unused atlas blocks.

    The exit status is 0 if the pack can be rendered as meant, and 2 if not.

    Args:
        pack: The pack, a folder or a .zip.
        json: Also write the findings to this file; "-" prints them instead of the text.
        strict: Treat warnings as errors.
    """
    check_results(json)
    findings = check_pack(_read(pack))
    if not write_json(json, {"path": str(pack), "findings": [asdict(finding) for finding in findings]}):
        print_findings(findings, Console())
    broken = [f for f in findings if f.severity == "error" or (strict and f.severity == "warning")]
    if broken:
        sys.stdout.flush()
        rules = ", ".join(finding.rule for finding in broken)
        raise UserError(f"breaks {len(broken)} rules ({rules})", where=pack, remedy="bake it again")


def convert(pack: Path, /, out: Path, codec: str = "avif", quality: int | None = None, force: bool = False) -> None:
    """Converts a pack to another codec: png (published layout), webp (lossless), avif, h264 or jpeg.

    Args:
        pack: The pack, a folder or a .zip.
        out: Folder of the new pack, or a file name that ends in .zip. A new pack replaces an old one when it is complete.
        codec: png (the published web viewer opens it), webp (lossless, two thirds of PNG), avif (lossy, about a third of
            PNG), h264 (lossy, the paper's; needs PyAV) or jpeg (lossy).
        quality: Quality of a lossy codec, 1 (smallest) ... 100 (best). The default is 83 for avif, 85 for h264, 95 for jpeg.
        force: Let a lossy codec replace the pack that is converted. What is lost then cannot be brought back.
    """
    lossy = chosen_quality(codec_named(codec, "--codec"), quality) is not None  # now, not after the work is done
    if lossy and not force and _is_same(out, pack):
        raise UserError(f"{codec} is lossy, and would replace the pack that is converted", where=out,
                        remedy="choose another --out, a lossless --codec (png, webp), or add --force")  # fmt: skip
    check_target(out)
    with open_pack(pack) as reader:
        before, stored = _read_all(reader), stored_bytes(pack)
    with progress("encoding", 1) as bar:
        save_pack(before, out, codec=codec, quality=quality, on_progress=lambda done, total: bar.update(done / total))
    print(f"{out}: {codec}, {_size(out, stored)}")


def edit(
    pack: Path,
    /,
    out: Path,
    crop: str | None = None,
    sphere: str | None = None,
    fainter_than: float | None = None,
    voxels: Path | None = None,
    smaller_than: int | None = None,
    keep_largest: bool = False,
    codec: str | None = None,
    quality: int | None = None,
) -> None:
    """Writes a pack without some of its voxels. What the options name is removed, in their order. Voxels hang together where they
    share a face, an edge or a corner.

    Args:
        pack: The pack, a folder or a .zip.
        out: Folder of the new pack, or a file name that ends in .zip.
        crop: Remove what is outside of the box x0,y0,z0,x1,y1,z1 of the grid frame.
        sphere: Remove what is within the sphere x,y,z,radius of the grid frame.
        fainter_than: Remove voxels with less opacity than this, 0 ... 1.
        voxels: Remove the voxels that this file names: what was erased in the viewer, which writes such files.
        smaller_than: Remove parts that hang together by fewer voxels than this, but never the largest.
        keep_largest: Remove all but the largest part that hangs together.
        codec: As of convert. The default is that of the pack. A lossy codec loses a little once more.
        quality: Quality of a lossy codec, 1 (smallest) ... 100 (best). The default is that of the pack.
    """
    box = parse_crop(crop) if crop else None
    ball = parse_numbers(sphere, 4, "--sphere") if sphere else None
    require_in_range("--fainter-than", fainter_than, 1e-3, 1)
    require_in_range("--smaller-than", smaller_than, 1, 1e12)
    if _is_same(out, pack):
        raise UserError("would replace the pack that is edited", where=out, remedy="choose another --out")
    chosen: dict[str, Callable[[Voxels], Selection]] = {}
    if box is not None:
        chosen[f"--crop {crop}"] = lambda each: each.everything() - each.in_box(box)
    if ball is not None:
        chosen[f"--sphere {sphere}"] = lambda each: each.in_sphere(np.array(ball[:3]), ball[3])
    if fainter_than is not None:
        chosen[f"--fainter-than {fainter_than:g}"] = lambda each: each.fainter_than(fainter_than)
    if voxels is not None:
        chosen["by hand"] = lambda each: Selection.load(voxels, each.pack)
    if smaller_than is not None:
        chosen[f"--smaller-than {smaller_than}"] = lambda each: each.parts().smaller_than(smaller_than)
    if keep_largest:
        chosen["--keep-largest"] = lambda each: each.parts().smaller_than()
    if not chosen:
        raise UserError("there is nothing to remove", remedy="add --keep-largest or another option; see --help")
    check_target(out)
    with open_pack(pack) as reader:
        codec, quality = _codec_of(reader.outline, codec, quality)
        before, stored = with_annotations(_read_all(reader), pack), stored_bytes(pack)
    with progress("removing", 1) as bar:
        removed, atlas = NOTHING, EditPreview(Voxels(before))
        for done, choose in enumerate(chosen.values(), 1):
            removed = removed | choose(atlas.voxels)
            atlas.follow(removed, NOTHING)  # what is chosen next is chosen of what is left
            bar.update(0.5 * done / len(chosen))
        after = without(before, removed, list(chosen))
        save_pack(after, out, codec=codec, quality=quality,
                  on_progress=lambda done, total: bar.update(0.5 + 0.5 * done / total, "encoding"))  # fmt: skip
    gone = int(before.occupied.sum()) - int(after.occupied.sum())
    print(f"{out}: without {removed.count:,} voxels and {gone:,} macroblocks, {codec}, {_size(out, stored)}")


def _is_same(out: Path, pack: Path) -> bool:
    return out.exists() and pack.exists() and out.samefile(pack)


def _size(pack: Path, before: int) -> str:
    """Bytes of a pack beside those of the pack that it was made from, in words."""
    after = stored_bytes(pack)
    return f"{after / 1e6:.2f} MB, {100 * after / max(before, 1):.0f} % of {before / 1e6:.2f} MB before"


def _codec_of(pack: Pack, codec: str | None, quality: int | None) -> tuple[str, int | None]:
    """The codec and the quality to write an edited pack with: its own where nothing else is wanted."""
    settings = pack.metadata.get(SETTINGS)
    if codec is None and quality is None and isinstance(settings, Mapping) and type(settings.get("quality")) is int:
        quality = settings["quality"]
    name = codec or pack.params.get("format", "png")
    chosen_quality(codec_named(name, "--codec"), quality)  # now, not after the work is done
    return name, quality


def move(
    pack: Path,
    /,
    out: Path,
    up: str | None = None,
    turn: float = 0.0,
    origin: str | None = None,
    scale: str | None = None,
) -> None:
    """Copies a pack and places the scene: what is up, which way it is turned, its origin and its scale. No voxel changes; the
    viewer, snerg-render, exports and web pages follow.

    Args:
        pack: The pack, a folder or a .zip.
        out: Folder of the new pack, or a file name that ends in .zip.
        up: What is up, x,y,z in the grid frame; or auto: across the ground that is found, which becomes height 0.
        turn: Turn the scene about what is up by this many degrees, counter-clockwise from above.
        origin: The point x,y,z of the grid frame that becomes the origin.
        scale: The length of a unit of the grid frame, with its unit (m, cm, mm, in or ft) if it has one: 0.35m.
    """
    if up is None and not turn and origin is None and scale is None:
        raise UserError("there is nothing to change", remedy="add --up, --turn, --origin or --scale; see --help")
    direction = None if up in (None, "auto") else np.array(parse_point(up, "--up"))
    if direction is not None and np.linalg.norm(direction) < SHORTEST_DIRECTION:
        raise UserError("is not a direction", where="--up", found=up)
    require_in_range("--turn", turn, -MOST_TURN, MOST_TURN)
    point = None if origin is None else parse_point(origin, "--origin")
    if point is not None and max(map(abs, point)) > MOST_LENGTH:
        expected = f"at most {MOST_LENGTH:g} grid units away"
        raise UserError("is out of range", where="--origin", expected=expected, found=origin)
    length = None if scale is None else _length(scale)
    if _is_same(out, pack):
        raise UserError("would replace the pack that is moved", where=out, remedy="choose another --out")
    check_target(out)
    with open_pack(pack) as reader:
        outline = with_annotations(reader.outline, pack)
        if outline.ndc and (up is not None or turn):
            raise UserError("is a forward-facing pack, which is seen from one side", where=pack,
                            remedy="leave out --up and --turn")  # fmt: skip
        placement = placement_of(outline)
        if up == "auto":
            at, direction = ground_plane(_read_all(reader), placement.up)
            placement = placement.levelled(direction, at)
        elif direction is not None:
            placement = placement.levelled(direction)
        if turn:
            now, *others = placement.angles
            placement = placement.with_angles(now + turn, *others)
        if point is not None:
            placement = Placement(placement.rotation, point)
        kept = outline.metadata.get(MARKS)
        marks = {**(kept if isinstance(kept, Mapping) else {}), "placement": placement_to_json(placement)}
        if length is not None:
            marks["scale"] = {"factor": length[0], "unit": length[1]}
        moved = outline.with_metadata(**{MARKS: marks})
        copy_pack(reader.files, moved, out)
    where, upwards = (",".join(f"{value:.6g}" for value in vector) for vector in (placement.origin, placement.up))
    factor, unit = np.cbrt(np.linalg.det(placed_T_grid(moved)[:3, :3])), marks.get("scale", {}).get("unit", "")
    print(f"{out}: up is {upwards}, the origin is {where}, 1 grid unit is {factor:.6g} {unit}".rstrip())


def _length(text: str) -> tuple[float, str]:
    """A number and its unit. UserError for anything else."""
    unit = next(each for each in sorted(UNITS, key=len, reverse=True) if text.endswith(each))
    try:
        number = float(text.removesuffix(unit))
    except ValueError:
        number = 0.0
    if not SCALES[0] <= number <= SCALES[1]:
        expected = "a number and m, cm, mm, in, ft or nothing: 0.35m"
        raise UserError("is not a length", where="--scale", expected=expected, found=text)
    return number, unit


def export(
    pack: Path,
    /,
    to: Path,
    options: Annotated[Export, tyro.conf.arg(name="")],
    crop: str | None = None,
    title: str | None = None,
    credits: str = "",
    path: Path | None = None,
    pose: str | None = None,
) -> None:
    """Writes a pack as one web page that shows it as the viewer does; or as a mesh, as points, or as 3D Gaussians for other
    programs, whose colours do not depend on the view.

    Args:
        pack: The pack, a folder or a .zip.
        to: FILE.html (a web page in one file), FOLDER/ (a web page for a web server), FILE.glb (a mesh), FILE.spz (Gaussians), or
            FILE.ply, whose name (points.ply, mesh.ply, gaussians.ply) or --kind says what it holds.
        options: Of files for other programs.
        crop: Only what is in the box x0,y0,z0,x1,y1,z1 of the grid frame.
        title: Heading of a web page. The default is the pack's name.
        credits: Line below the heading of a web page.
        path: Camera path that a web page plays, as the viewer or nerfstudio saves it (JSON).
        pose: First camera of a web page, as snerg-view takes it.
    """
    box = parse_crop(crop) if crop else None
    if to.suffix.lower() in PAGE_SUFFIXES or not to.suffix or to.is_dir():
        if options.kind is not None:
            raise UserError(f"cannot hold {options.kind}", where=to, expected="a web page", remedy="leave out --kind")
        content = PageContent(title or pack.resolve().stem, credits, path, box, pose, source=pack)
        _export_page(with_annotations(_read(pack), pack), to, content)
        return
    for option, value in (("--title", title), ("--credits", credits), ("--path", path), ("--pose", pose)):
        if value:
            raise UserError("is of web pages alone", where=option, expected="--to FILE.html or FOLDER/", found=to)
    wanted = replace(options, kind=kind_for(to, options.kind), crop=box)
    check_export(wanted)
    check_results(to)
    loaded = with_annotations(_read(pack), pack)
    with progress("exporting", 1) as bar:
        written = export_scene(loaded, to, wanted, bar.update)
    amount = f"{written.faces:,} triangles" if written.faces else f"{written.points:,} {wanted.kind}"
    merged = "" if written.coarser == 1 else f", {written.coarser}³ voxels merged into one"
    print(f"{to}: {amount}{merged}, {to.stat().st_size / 1e6:.2f} MB")


def _export_page(pack: Pack, to: Path, content: PageContent) -> None:
    """As one file, or in a folder as several, index.html last: before, an older page stays whole."""
    one = to.suffix.lower() in PAGE_SUFFIXES and not to.is_dir()
    check_results(to if one else None, folder=None if one else to)
    with progress("exporting", 1) as bar:
        files = {to.name: scene_page(pack, content, bar.update)} if one else scene_files(pack, content, bar.update)
    for name, data in files.items():
        write_result(to if one else to / name, data)
    size = sum(map(len, files.values())) / 1e6
    print(f"{to}: a web page, {size:.2f} MB" if one else f"{to / INDEX}: a web page for a web server, {size:.2f} MB")


def compare(a: Path, b: Path, /, views: int = 8, size: str = "400x400", json: Path | None = None) -> None:
    """Renders two packs from the same cameras and measures the difference: PSNR (dB), SSIM.

    Args:
        a: The reference pack, a folder or a .zip.
        b: The other pack.
        views: Number of views on an orbit around the content, 1 ... 1000.
        size: Size of each picture, WIDTHxHEIGHT in pixels.
        json: Also write the figures to this file; "-" prints them instead of the text.
    """
    from baker.reports.pack_compare import compare_packs  # OpenGL starts here, not for info

    require_in_range("--views", views, 1, 1000)
    pixels = parse_size(size)
    check_results(json)
    result = compare_packs(a, b, views, pixels)
    if write_json(json, result):
        return
    for pack in (result["a"], result["b"]):
        print(f"{pack['path']}: {pack['codec']}, {pack['bytes'] / 1e6:.2f} MB")
    for view in (*result["views"], {"name": f"mean of {views} views", **result}):
        ssim = "" if view["ssim"] is None else f", SSIM {view['ssim']:.4f}"
        apart = f"PSNR {view['psnr']:.2f} dB{ssim}, at most {view['worst']}/255 apart"
        print(one_line(f"{view['name']}: {apart if view['worst'] else 'identical'}"))


def _read(pack: Path) -> Pack:
    with open_pack(pack) as reader:
        return _read_all(reader)


def _read_all(reader: PackReader) -> Pack:
    with progress("reading", reader.total) as bar:
        return reader.read(lambda done, _total: bar.update(done))


COMMANDS = {each.__name__: each for each in (info, check, convert, edit, move, export, compare)}


def main(args: Sequence[str] | None = None) -> int:
    return run_command(COMMANDS, prog="snerg-pack", description=DESCRIPTION, args=args)
