"""A pack as one HTML file that shows it: shaders, data, and the modules of viewer/web/static.

The file needs no network, and its Content-Security-Policy forbids any. What comes from a pack stands in it as JSON, as base64,
and as numbers of a shader (viewer.rendering.shader_source.glsl_float); the page shows names as text, never as markup.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from console.streams import one_line
from scenepack.pack import Pack
from viewer.core.annotations import KEY, Annotations, annotations_from_json
from viewer.core.pose import Pose, Turntable
from viewer.features.bookmarks.bookmarks import pose_of
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.display.display import backdrop
from viewer.features.film.camera_path import CameraPath, load_path
from viewer.rendering.framing import outline
from viewer.rendering.gpu_memory import NoRoomError
from viewer.rendering.gpu_scene import Triple, atlas_size, features_stored, indirection_grid, tightest_atlas
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.renderer import MODES_OVER_BACKGROUND, shader_defines, shades_hull_alone, view_mlp_text
from viewer.rendering.settings import RenderSettings
from viewer.rendering.shader_source import assemble_es, define_lines
from viewer.rendering.skip_grid import skip_grid_of
from viewer.web.atlas_stream import BLOCKS_A_CHUNK, compressed_chunks, has_copied_padding

FOLDER = Path(__file__).parent / "static"
MODULES = ("vectors.js", "scene.js", "renderer.js", "camera.js", "resolution.js", "controls.js", "main.js")
WORKER = "decode.js"
MODES = ("normal", "diffuse", "features", "view-dependent", "depth", "normals")
SIDES = (512, 1024, 2048)  # voxels of a 3D texture; the smallest that holds the pack, for small devices take less
LONGEST_TITLE = 120  # characters
PATH_FPS = 10.0  # poses a second of a camera path; the page interpolates
Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
OnProgress = Callable[[float], None]


@dataclass(frozen=True)
class PageContent:
    """What a page shows besides the pack."""

    title: str
    path: CameraPath | None = None  # flown by a button
    crop: Corners | None = None  # corners of a box in the grid frame outside of which nothing is shown


def path_from_file(file: Path, pack: Pack) -> CameraPath:
    """A camera path that the viewer or nerfstudio saved. UserError for anything else."""
    return load_path(file, pack.worldspace_T_opengl)


def scene_page(pack: Pack, content: PageContent, on_progress: OnProgress = lambda share: None) -> bytes:
    """The page, UTF-8. on_progress is called with the share that is done. UserError where the pack is too large for it."""
    description, data = _scene(pack, content, on_progress)
    shaders = _shaders(pack, {name: tuple(description[name]["size"]) for name in ("atlas", "indirection", "skip_grid")})
    return assemble_page(content.title, description, shaders, data)


def assemble_page(title: str, description: Mapping[str, Any], shaders: Mapping[str, Any], data: bytes) -> bytes:
    """index.html with everything in its place. description, shaders: for viewer/web/static/scene.js; data: its sections."""
    style, script = _text("style.css"), bundle(MODULES)
    csp = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; worker-src blob:; child-src blob:; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    parts = {
        "title": html.escape(one_line(title, LONGEST_TITLE)),
        "policy": csp,
        "style": style,
        "script": script,
        "worker": _text(WORKER),
        "scene": json_for_markup(description),
        "shaders": base64.b64encode(zlib.compress(json_for_markup(shaders).encode(), 9)).decode("ascii"),
        "data": base64.b64encode(data).decode("ascii"),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _text("index.html")).encode()


def json_for_markup(value: Any) -> str:
    """JSON that no HTML parser takes for a tag or a comment."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e")


def bundle(names: tuple[str, ...]) -> str:
    """ES modules of the page as one, in this order: their imports of one another fall away."""
    texts = []
    for name in names:
        text = re.sub(r"^import [^;]*;\n", "", _text(name), flags=re.M)
        texts.append(re.sub(r"^export ", "", text, flags=re.M))
    return "\n".join(texts)


def _text(name: str) -> str:
    """A file of the page without indentation and lines of comment."""
    lines = (line.strip() for line in (FOLDER / name).read_text(encoding="utf-8").splitlines())
    return "\n".join(line for line in lines if line and not line.startswith("//"))


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


# --- Description of the scene, and its data ---


class _Sections:
    """Byte strings one behind the other, and where each lies."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.end = 0

    def add(self, data: bytes) -> list[int]:
        """Offset and length of `data`."""
        place = [self.end, len(data)]
        self.parts.append(data)
        self.end += len(data)
        return place


def _scene(pack: Pack, content: PageContent, on_progress: OnProgress) -> tuple[dict[str, Any], bytes]:
    features, count = features_stored(pack), int(pack.occupied.sum())
    slots = _slots(count, pack.padded_block_size, 2 if features else 1)
    size = atlas_size(slots, pack.padded_block_size, 2 if features else 1)
    skip_grid, sections = skip_grid_of(pack), _Sections()
    words = skip_grid.words.astype("<u2")
    indirection = indirection_grid(pack.occupied, slots)
    grids = {"indirection": indirection.shape[2::-1], "skip_grid": words.shape[::-1]}
    frame = RayFrame(pack)
    low, high = frame.box(RenderSettings(crop=content.crop))
    inner_low, inner_high = frame.box(RenderSettings(crop=content.crop, surroundings=False))
    description: dict[str, Any] = {
        "title": one_line(content.title, LONGEST_TITLE),
        "gridSize": pack.grid_size,
        "minXyz": pack.min_xyz,
        "voxelSize": pack.voxel_size,
        "trainingTGrid": frame.training_T_grid,
        "ndc": pack.ndc,
        "contracted": pack.contraction is not None,
        "box": [low, high],
        "innerBox": [inner_low, inner_high],
        "depthBox": frame.box(RenderSettings(surroundings=False)),
        "uniforms": {
            **frame.ndc, **frame.contraction,
            "grid_size": pack.grid_size, "content_min": skip_grid.content_min, "content_max": skip_grid.content_max,
        },
        "indirection": {"size": grids["indirection"], "at": sections.add(zlib.compress(indirection.tobytes(), 9))},
        "skip_grid": {"size": grids["skip_grid"], "at": sections.add(zlib.compress(words.tobytes(), 9))},
        "camera": _camera(pack),
        "path": _path(content.path),
    }  # fmt: skip
    if shades_hull_alone(pack, RenderSettings()):
        description["hull"] = sections.add(zlib.compress(skip_grid.hull.astype("<f4").tobytes(), 9))
    padding = not has_copied_padding(pack)
    chunks = []
    for bits, differences in compressed_chunks(pack, features=features, padding=padding):
        chunks.append([sections.add(bits), sections.add(differences)])
        on_progress(len(chunks) / max(-(-count // BLOCKS_A_CHUNK), 1))
    description["atlas"] = {
        "size": size, "slots": slots, "block": pack.padded_block_size, "features": features, "padding": padding,
        "count": count, "chunks": chunks,
    }  # fmt: skip
    return _plain(description), b"".join(sections.parts)


def _slots(count: int, block: int, parts: int) -> Triple:
    for side in SIDES:
        try:
            return tightest_atlas(count, block, side, parts)
        except NoRoomError:
            pass
    raise UserError("the pack is too large for a web page", remedy="bake it at a lower resolution")


def _shaders(pack: Pack, sizes: Mapping[str, Triple]) -> dict[str, Any]:
    """Texts by file name; the #define lines of each mode, and those that show a gradient behind the scene."""
    features, generated = features_stored(pack), view_mlp_text(pack)
    unused = ["march_paper.glsl", "march_brute.glsl", "march_atlas.glsl", "view_mlp_textures.glsl"]
    unused += [] if pack.contraction is not None else ["path.glsl"]
    texts = {
        name: assemble_es(name)
        for name in ("fullscreen.vert", "content_hull.vert", "content_hull.frag", "backdrop.frag")
    }
    texts["snerg.frag"] = assemble_es("snerg.frag", generated | dict.fromkeys(unused, ""))
    shown = backdrop("gradient", "dark")
    assert shown is not None
    modes: dict[str, str] = {}
    for mode in MODES:
        if mode in ("features", "view-dependent") and not features:
            continue
        settings = RenderSettings(mode=mode)  # type: ignore[arg-type]
        modes[mode] = define_lines(shader_defines(pack, settings, sizes=sizes, features_beside=features))
    over = RenderSettings(backdrop=shown)
    behind = define_lines(shader_defines(pack, over, sizes=sizes, features_beside=features))
    common = [
        line for line in modes["normal"].splitlines() if all(line in text.splitlines() for text in modes.values())
    ]
    return {
        "texts": texts,
        "common": "\n".join(common) + "\n",
        "modes": {
            mode: "".join(f"{line}\n" for line in text.splitlines() if line not in common)
            for mode, text in modes.items()
        },
        "backdrop": "".join(f"{line}\n" for line in behind.splitlines() if line not in modes["normal"].splitlines()),
        "backdropColours": [shown.first, shown.second],
        "overBackground": [mode for mode in modes if mode in MODES_OVER_BACKGROUND],
    }


def _camera(pack: Pack) -> dict[str, Any]:
    """The first view, what it turns about, its limits, and the bookmarks of the pack."""
    rig = orbit_camera_for(pack)
    own = pack.metadata.get(KEY)
    kept = annotations_from_json(own, lambda complaint: None) if own is not None else Annotations()
    bookmarks = []
    for bookmark in kept.bookmarks:
        table = replace(rig.table, up=bookmark.up)
        bookmarks.append({"name": bookmark.name, "fov": bookmark.fov, **_view(pose_of(bookmark, table), table)})
    return {
        "home": _view(rig.home_pose, rig.table),
        "fov": rig.home_fov,
        "bounded": rig.bounded,
        "mirrored": rig.table.mirrored,
        "within": rig.within,
        "radius": rig.radius,
        "middle": rig.middle,
        "outline": [] if rig.bounded else outline(pack),
        "bookmarks": bookmarks,
    }


def _view(pose: Pose, table: Turntable) -> dict[str, Any]:
    axes = [axis.tolist() for axis in table.axes]
    return {
        "pivot": pose.pivot, "azimuth": pose.azimuth, "elevation": pose.elevation, "distance": pose.distance, "axes": axes,
    }  # fmt: skip


def _path(path: CameraPath | None) -> dict[str, Any] | None:
    if path is None or not path.keyframes:
        return None
    frames = path.sample(PATH_FPS)
    rows = [[*np.round(matrix[:3].ravel(), 7).tolist(), round(fov, 4)] for matrix, fov in frames]
    return {"fps": PATH_FPS, "closed": path.closed, "frames": rows}


def _plain(value: Any) -> Any:
    """Arrays and tuples as lists, row-major."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
