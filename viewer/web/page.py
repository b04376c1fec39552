"""A pack as a web page that shows it: one HTML file, or index.html and the files that it loads.

One file needs no network, and its Content-Security-Policy forbids any; index.html may ask its own server. What comes from a pack
stands in the page as base64: JSON, numbers of shaders (viewer.rendering.shader_source.glsl_float) and textures. The page shows
names as text, never as markup.
"""

import base64
import hashlib
import html
import json
import re
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from console.streams import one_line
from scenepack.pack import Pack
from viewer.web.description import LONGEST_TITLE, OnProgress, PageContent, describe

FOLDER = Path(__file__).parent / "static"
MODULES = (
    "vectors.js",
    "scene.js",
    "renderer.js",
    "camera.js",
    "overlay.js",
    "resolution.js",
    "controls.js",
    "main.js",
)
INDEX = "index.html"


def scene_page(pack: Pack, content: PageContent, on_progress: OnProgress = lambda share: None) -> bytes:
    """The page as one file, UTF-8. on_progress is called with the share that is done. UserError where the pack is too large."""
    description, data = describe(pack, content, on_progress)
    return assemble_page(content.title, description, data.values())


def scene_files(pack: Pack, content: PageContent, on_progress: OnProgress = lambda share: None) -> dict[str, bytes]:
    """The page as files for a web server, index.html last. Otherwise as scene_page."""
    description, data = describe(pack, content, on_progress)
    for level in description["levels"]:  # browsers keep files by their address
        level["file"] += f"?{hashlib.sha256(data[level['file']]).hexdigest()[:12]}"
    return {**data, INDEX: assemble_page(content.title, description)}


def assemble_page(title: str, description: Mapping[str, Any], data: Iterable[bytes] = ()) -> bytes:
    """index.html, filled in. description: for viewer/web/static/scene.js. data: of its levels; none: in files."""
    # the modules as one script, in their order: their imports of one another fall away
    modules = (re.sub(r"^import [^;]*;\n|^export ", "", _text(name), flags=re.M) for name in MODULES)
    script = '"use strict";{\n' + "\n".join(modules) + "}"
    style, loader, inside = _text("style.css"), _text("loader.js"), list(data)
    asks = "'none'" if inside and not description["live"] else "'self'"
    csp = (
        f"default-src 'none'; script-src '{_hash(loader)}' '{_hash(script)}'; style-src '{_hash(style)}'; "
        f"worker-src blob:; child-src blob:; img-src data:; connect-src {asks}; base-uri 'none'; form-action 'none'"
    )
    whole = {**description, "script": script, "worker": _text("decode.js")}
    text = json.dumps(whole, separators=(",", ":"), allow_nan=False, default=lambda array: array.tolist())
    parts = {
        "title": html.escape(one_line(title, LONGEST_TITLE)),
        "policy": csp,
        "style": style,
        "loader": loader,
        "scene": _base64(zlib.compress(text.encode(), 9)),
        "data": "\n".join(f'<script type="text/plain" class="data">{_base64(each)}</script>' for each in inside),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _text(INDEX)).encode()


def _text(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _hash(text: str) -> str:
    return "sha256-" + _base64(hashlib.sha256(text.encode()).digest())
