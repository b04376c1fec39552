"""What a page knows of a scene, as JSON and bytes: its levels of detail, shaders, views, camera path and measurements.

A level is the pack at one resolution. The page shows the coarsest first, and stays at one where the device cannot hold the next.
"""

import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from math import log2
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from console.streams import one_line
from scenepack.blocks import Triple
from scenepack.exports.field import Corners
from scenepack.pack import Pack
from scenepack.piece_files import follows_grid
from scenepack.placement import moved_pose
from scenepack.writer import metadata_writable
from viewer.core import annotations as notes
from viewer.core.annotations import Annotations
from viewer.core.pose import pose_from_text
from viewer.features.bookmarks.bookmarks import pose_of
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.display.display import backdrop
from viewer.features.film.camera_path import CameraPath, load_path
from viewer.features.measuring.measure_tool import LengthFormat
from viewer.rendering import renderer
from viewer.rendering.camera import outline
from viewer.rendering.gpu_scene import (
    NoRoomError,
    atlas_size,
    features_stored,
    half_resolution,
    indirection_grid,
    tightest_atlas,
)
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.settings import Look, Mode, RenderSettings
from viewer.rendering.shader_source import assemble_es, define_lines, glsl_vec3, view_mlp_includes
from viewer.rendering.skip_grid import skip_grid_of
from viewer.web.atlas_stream import BLOCKS_A_CHUNK, FilmedPiece, compressed_chunks, films_of

MODES: tuple[Mode, ...] = ("normal", "diffuse", "features", "view-dependent", "depth", "normals")
SIDES = (512, 1024, 2048)  # voxels of a 3D texture; the smallest that holds the pack, for small devices take less
COARSE = 1 << 22  # voxels of an atlas; larger ones are halved for the first picture, until they are not
LONGEST_TITLE, LONGEST_CREDITS = 120, 400  # characters
PATH_FPS = 10.0  # poses a second of a camera path; the page interpolates
OnProgress = Callable[[float], None]


@dataclass(frozen=True)
class PageContent:
    """What a page shows besides the pack."""

    title: str
    credits: str = ""  # shown below the title
    path: Path | None = None  # of a camera path that the viewer or nerfstudio saved, flown by a button
    crop: Corners | None = None  # corners of a box in the grid frame outside of which nothing is shown
    pose: str | None = None  # first camera, as the viewer copies it; None: the viewer's first
    live: bool = False  # whether the page asks the server for newer ones
    source: Path | None = None  # where the pack lies; the films of an AVIF pack are taken from there


def with_annotations(pack: Pack, path: Path) -> Pack:
    """The pack at `path` with what the viewer keeps of it elsewhere, where it does, as if it were the pack's own."""
    found = notes.read_annotations(pack, path, notes.default_folder())
    if metadata_writable(pack, path) or found == Annotations():
        return pack
    return pack.with_metadata(**{notes.KEY: notes.annotations_to_json(found)})


def describe(pack: Pack, content: PageContent, on_progress: OnProgress) -> tuple[dict[str, Any], dict[str, bytes]]:
    """What viewer/web/static/scene.js reads, and the data of its levels by the name of their files, coarsest first.

    Arrays are row-major. on_progress is called with the share that is done. UserError where the pack is too large, or the path
    is none.
    """
    path = None if content.path is None else _path(load_path(content.path, pack.worldspace_T_opengl))
    annotations = notes.read_annotations(pack)  # bookmarks become buttons, measurements are drawn
    levels = [pack]
    while _atlas_voxels(levels[0]) > COARSE and max(levels[0].grid_size) >= renderer.LEAST_HALVED:
        levels.insert(0, half_resolution(levels[0]))
    films = films_of(content.source) if content.source is not None and len(levels) > 1 else None
    if films is not None:  # levels between would take more than the films
        levels = [levels[0], pack]
    total, done = max(sum(map(_atlas_voxels, levels)), 1), 0
    described, data = [], {}
    for level in levels:

        def progress(part: float, before: int = done, voxels: int = _atlas_voxels(level)) -> None:
            on_progress((before + part * voxels) / total)

        about, sections = _level(level, content.crop, films if level is pack else None, progress)
        name = f"scene-{max(level.grid_size)}.bin"
        data[name] = b"".join(sections)
        halvings = round(log2(max(pack.grid_size) / max(level.grid_size)))
        described.append({**about, "file": name, "bytes": len(data[name]), "halvings": halvings})
        done += _atlas_voxels(level)
    words = LengthFormat(pack, annotations)
    description = {
        "title": one_line(content.title, LONGEST_TITLE),
        "credits": one_line(content.credits, LONGEST_CREDITS) if content.credits else "",
        "gridSize": pack.grid_size,
        "ndc": pack.ndc,
        "contracted": pack.contraction is not None,
        "levels": described,
        "shaders": _shaders(pack, annotations.look),
        "camera": _camera(pack, content.pose, annotations),
        "path": path,
        "measurements": [{"points": m.points, "text": words.measurement(m)} for m in annotations.measurements],
        "live": content.live,
    }
    return description, data


def _atlas_voxels(pack: Pack) -> int:
    return int(pack.occupied.sum()) * pack.padded_block_size**3


def _add(sections: list[bytes], data: bytes) -> list[int]:
    """Appends a section; its offset and length."""
    sections.append(data)
    return [sum(map(len, sections[:-1])), len(data)]


def _column_major(uniforms: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Numbers, vectors and matrices as WebGL takes them."""
    return {name: np.ravel(value, order="F") for name, value in uniforms.items()}


def _level(
    pack: Pack, crop: Corners | None, films: list[FilmedPiece] | None, on_progress: OnProgress
) -> tuple[dict[str, Any], list[bytes]]:
    """A pack without its shaders, and its data: its films where there are some."""
    features, count = features_stored(pack), int(pack.occupied.sum())
    slots = _slots(count, pack.padded_block_size, 2 if features else 1)
    size = atlas_size(slots, pack.padded_block_size, 2 if features else 1)
    skip_grid, sections = skip_grid_of(pack), list[bytes]()
    words = skip_grid.words
    halves = np.stack([words & 255, words >> 8]).astype(np.uint8)  # each compresses better alone
    indirection = indirection_grid(pack.occupied, slots)
    sizes = {"atlas": size, "indirection": indirection.shape[2::-1], "skip_grid": words.shape[::-1]}
    frame = RayFrame(pack)
    description: dict[str, Any] = {
        "minXyz": pack.min_xyz,
        "voxelSize": pack.voxel_size,
        "trainingTGrid": frame.training_T_grid,
        "ndc": pack.ndc,
        "box": frame.box(RenderSettings(crop=crop)),
        "innerBox": frame.box(RenderSettings(crop=crop, surroundings=False)),
        "depthBox": frame.box(RenderSettings(surroundings=False)),
        "uniforms": _column_major({
            **frame.ndc, **frame.contraction,
            "grid_size": pack.grid_size, "content_min": skip_grid.content_min, "content_max": skip_grid.content_max,
        }),
        "defines": define_lines({
            f"{name.upper()}_TEXEL": glsl_vec3(1.0 / side for side in each) for name, each in sizes.items()
        }),
        "indirection": {"size": sizes["indirection"], "at": _add(sections, zlib.compress(indirection.tobytes(), 9))},
        "skip_grid": {"size": sizes["skip_grid"], "at": _add(sections, zlib.compress(halves.tobytes(), 9))},
    }  # fmt: skip
    if renderer.shades_hull_alone(pack, RenderSettings()):
        description["hull"] = _add(sections, zlib.compress(skip_grid.hull.astype("<f4").tobytes(), 9))
    padding = films is None and not all(follows_grid(pack, atlas) for atlas in pack.atlases)
    layout: dict[str, Any] = {
        "size": size, "slots": slots, "block": pack.padded_block_size, "features": features, "padding": padding, "count": count,
    }  # fmt: skip
    description["atlas"] = layout
    if films is not None:
        layout["pieces"] = [_piece(piece, sections, features=features) for piece in films]
        return description, sections
    layout["chunks"] = chunks = []
    for bits, differences in compressed_chunks(pack, features=features, padding=padding):
        chunks.append([_add(sections, bits), _add(sections, differences)])
        on_progress(len(chunks) / max(-(-count // BLOCKS_A_CHUNK), 1))
    return description, sections


def _piece(filmed: FilmedPiece, sections: list[bytes], *, features: bool) -> dict[str, Any]:
    piece, occupied, films = filmed  # films as zlib for its checksum: a damaged one plays on
    return {
        "corner": piece.corner[::-1],
        "shape": piece.shape[::-1],
        "occupied": _add(sections, occupied),
        "films": [
            {"codec": film.codec, "at": _add(sections, zlib.compress(film.data, 0)), "sizes": film.sizes}
            for film in (films if features else films[:2])
        ],
    }


def _slots(count: int, block: int, parts: int) -> Triple:
    for side in SIDES:
        with suppress(NoRoomError):
            return tightest_atlas(count, block, side, parts)
    raise UserError("the pack is too large for a web page", remedy="bake it at a lower resolution")


def _shaders(pack: Pack, look: Look | None) -> dict[str, Any]:
    """Texts by file name; the #define lines of each mode, and those that show a gradient behind the scene; uniforms of a look."""
    features, generated = features_stored(pack), view_mlp_includes(pack.view_mlp)
    unused = ["march_paper.glsl", "march_brute.glsl", "march_atlas.glsl", "view_mlp_textures.glsl"]
    unused += [] if pack.contraction is not None else ["path.glsl"]
    unused += [] if look is not None else ["look.glsl"]
    texts = {
        name: assemble_es(name)
        for name in ("fullscreen.vert", "content_hull.vert", "content_hull.frag", "backdrop.frag")
    }
    texts["snerg.frag"] = assemble_es("snerg.frag", generated | dict.fromkeys(unused, ""))
    shown = backdrop("gradient", "dark")
    assert shown is not None

    modes = [mode for mode in MODES if features or mode not in ("features", "view-dependent")]
    settings = [RenderSettings(mode=mode, look=look) for mode in modes]  # type: ignore[arg-type]
    return {
        "texts": texts,
        "modes": {
            each.mode: define_lines(renderer.shader_defines(pack, each, sizes={}, features_beside=features))
            for each in settings
        },
        "backdrop": define_lines({"BACKDROP": True}),
        "look": _column_major(renderer.look_uniforms(look)),
        "backdropColours": [shown.first, shown.second],
        "overBackground": [mode for mode in modes if mode in renderer.MODES_OVER_BACKGROUND],
    }


def _camera(pack: Pack, start: str | None, annotations: Annotations) -> dict[str, Any]:
    """The first view, what it turns about, its limits, and the bookmarks."""
    rig = orbit_camera_for(pack)
    rig.begin_placed(annotations.placement.rotation)
    home, fov = rig.home_pose, rig.home_fov
    if start is not None:
        try:
            placed_T_camera, fov_degrees, _ = pose_from_text(start)
            rig.set_matrix(moved_pose(np.linalg.inv(annotations.placed_T_grid), placed_T_camera), fov_degrees)
        except ValueError as error:
            raise UserError(str(error), where="--pose") from error
        home, fov = rig.goal, rig.fov
    bookmarks = []
    for bookmark in annotations.bookmarks:
        table = replace(rig.table, up=bookmark.up)
        said = {"name": bookmark.name, "text": bookmark.text, "point": bookmark.point}
        bookmarks.append({**said, "fov": bookmark.fov, **asdict(pose_of(bookmark, table)), "axes": table.axes})
    return {
        "home": {**asdict(home), "axes": rig.table.axes},
        "fov": fov,
        "bounded": rig.bounded,
        "mirrored": rig.table.mirrored,
        "framed": not (rig.bounded or rig.within or start is not None),
        "radius": rig.radius,
        "middle": rig.middle,
        "outline": [] if rig.bounded else outline(pack),
        "bookmarks": bookmarks,
    }


def _path(path: CameraPath) -> dict[str, Any] | None:
    if not path.keyframes:
        return None
    frames = path.sample(PATH_FPS)
    rows = [[*np.round(matrix[:3].ravel(), 7).tolist(), round(fov, 4)] for matrix, fov in frames]
    return {"fps": PATH_FPS, "closed": path.closed, "frames": rows}
