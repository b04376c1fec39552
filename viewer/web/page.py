"""A pack as a web page that shows it: one HTML file, or index.html and the files that it loads; and the server of such pages.

One file needs no network, and its Content-Security-Policy forbids any; index.html may ask its own server. What comes from a pack
stands in the page as text: JSON and numbers of shaders (viewer.rendering.shader_source.glsl_float) as base64; textures as UTF-16,
15 bits in each character of 16. The page shows names as text, never as markup. The server is for who has its address, of which a
random token is part. It serves nothing but the page's files, from memory.
"""

import base64
import hashlib
import hmac
import html
import json
import re
import secrets
import threading
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from console.streams import one_line
from scenepack.pack import Pack
from scenepack.reader import load_pack
from viewer.core.files import kind_of, pack_in
from viewer.core.state import name_of
from viewer.features.making.make_job import FileWatch, preview_title, read_preview
from viewer.features.making.make_plan import PREVIEW_FILE
from viewer.web.description import LONGEST_TITLE, OnProgress, PageContent, describe, with_annotations

FOLDER = Path(__file__).parent / "static"
MODULES = ["vectors", "scene", "renderer", "camera", "overlay", "resolution", "controls", "main"]
INDEX = "index.html"
FIRST_CHARACTER = 0x5000  # of 2 ** 15: none is markup or a surrogate
BYTES_AT_ONCE = 15 << 16  # a multiple of 15, which fill 8 characters


def scene_page(pack: Pack, content: PageContent, on_progress: OnProgress = lambda share: None) -> bytes:
    """The page as one file, UTF-16. on_progress is called with the share that is done. UserError where the pack is too large."""
    description, data = describe(pack, content, on_progress)
    return _assemble_page(content.title, description, data.values())


def scene_files(pack: Pack, content: PageContent, on_progress: OnProgress = lambda share: None) -> dict[str, bytes]:
    """The page as files for a web server, index.html last. Otherwise as scene_page."""
    description, data = describe(pack, content, on_progress)
    for level in description["levels"]:  # browsers keep files by their address
        level["file"] += f"?{hashlib.sha256(data[level['file']]).hexdigest()[:12]}"
    return {**data, INDEX: _assemble_page(content.title, description)}


def _assemble_page(title: str, description: Mapping[str, Any], data: Iterable[bytes] = ()) -> bytes:
    """index.html, filled in. description: for viewer/web/static/scene.js. data: of its levels; none: in files."""
    # the modules as one script, in their order: their imports of one another fall away
    modules = (re.sub(r"^import [^;]*;\n|^export ", "", _text(f"{name}.js"), flags=re.M) for name in MODULES)
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
        "data": "\n".join(f'<script type="text/plain" class="data">{_characters_of(each)}</script>' for each in inside),
    }
    page = re.sub(r"\{\{(\w+)\}\}", lambda match: parts[match[1]], _text(INDEX))
    return page.encode("utf-16" if inside else "utf-8")


def _text(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _characters_of(data: bytes) -> str:
    """15 bits in each character, the earlier bits the higher; zero bytes fill the last eight characters."""
    texts = []
    for at in range(0, len(data), BYTES_AT_ONCE):
        part = data[at : at + BYTES_AT_ONCE]
        bits = np.unpackbits(np.frombuffer(part + bytes(-len(part) % 15), np.uint8)).reshape(-1, 15)
        words = np.packbits(bits, axis=1).view(">u2") >> 1
        texts.append((words + FIRST_CHARACTER).astype("<u2").tobytes().decode("utf-16-le"))
    return "".join(texts)


def _hash(text: str) -> str:
    return "sha256-" + _base64(hashlib.sha256(text.encode()).digest())


# --- The server ---

HEADERS = {"Cache-Control": "no-store", "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff"}
PATIENCE_S = 60.0  # for a connection that says nothing


class PageServer(ThreadingHTTPServer):
    """Serves `files`, by name, at `address` while serve_forever() runs; they may be replaced by others meanwhile.

    port: 0 for any that is free. UserError where it cannot listen.
    """

    daemon_threads = True

    def __init__(self, files: Mapping[str, bytes], host: str, port: int) -> None:
        if not 0 <= port <= 65535:
            raise UserError("is out of range", where="--serve", expected="a port, 0 to 65535", found=port)
        self.files, self.path = files, f"/{secrets.token_urlsafe(16)}/"
        try:
            super().__init__((host, port), _Handler)
        except OSError as error:
            where, remedy = f"{host}:{port}", "choose another port: --serve PORT"
            raise UserError("cannot be listened on", where=where, found=error.strerror, remedy=remedy) from error

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host, port = self.server_address[:2]
        return f"http://{host!s}:{port}{self.path}"


class _Handler(BaseHTTPRequestHandler):
    server: PageServer  # pyright: ignore[reportIncompatibleVariableOverride]
    server_version, sys_version = "snerg", ""
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        token = len(self.server.path)
        known = hmac.compare_digest(self.path[:token].encode("latin-1", "replace"), self.server.path.encode())
        name = self.path[token:].partition("?")[0] or INDEX
        data = self.server.files.get(name) if known else None
        if data is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        tag = f'"{hashlib.sha256(data).hexdigest()}"'
        unchanged = self.headers.get("If-None-Match") == tag
        self.send_response(HTTPStatus.NOT_MODIFIED if unchanged else HTTPStatus.OK)
        kind = "text/html" if name == INDEX else "application/octet-stream"
        size = {} if unchanged else {"Content-Length": str(len(data))}
        for header, value in {**HEADERS, "Content-Type": kind, "ETag": tag, **size}.items():
            self.send_header(header, value)
        self.end_headers()
        if self.command == "GET" and not unchanged:
            self.wfile.write(data)

    do_HEAD = do_GET

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the address holds the token."""


# --- What is served ---

LOOK_EVERY_S = 1.0  # for a newer preview
WAITING = b"""<!doctype html><html lang="en"><head><meta charset="utf-8"><meta http-equiv="refresh" content="2">
<title>Training</title>
<style>body{font:16px system-ui;background:#0d1117;color:#e6ebf2;display:grid;place-items:center;height:90vh}</style></head>
<body><p>Waiting for the first preview of the training.</p></body></html>"""


def serve(path: Path, host: str, port: int, content: PageContent) -> None:
    """Prints the address and serves. path: a pack, or a run. content: without a title, it is the name of what is served.

    UserError for anything else.
    """
    kind = kind_of(path)
    if kind not in ("pack", "run"):
        raise UserError("is no pack and no run", where=path, remedy="name one: snerg-view PACK --serve")
    files = _files_of_pack(pack_in(path), content, name_of(path)) if kind == "pack" else {INDEX: WAITING}
    ended = threading.Event()
    with PageServer(files, host, port) as server:
        print(f"{server.address}\nCtrl-C ends it.", flush=True)
        if kind == "run":
            threading.Thread(target=_follow, args=(server, path, content, ended), daemon=True).start()
        try:
            server.serve_forever()
        finally:
            ended.set()


def _files_of_pack(path: Path, content: PageContent, name: str) -> dict[str, bytes]:
    shown = replace(content, title=content.title or name)
    return scene_files(with_annotations(load_pack(path), path), shown)


def _follow(server: PageServer, run: Path, content: PageContent, ended: threading.Event) -> None:
    """Serves each newer preview, as one file, so that no page is of two; the pack once it is there."""
    folder = run.parent if (run / "config.json").is_file() else run
    preview, pack = FileWatch(folder / PREVIEW_FILE, read_preview), folder / "pack"
    while not ended.wait(LOOK_EVERY_S):
        try:
            if pack.is_dir() and kind_of(pack) == "pack":
                server.files = _files_of_pack(pack, content, name_of(run))
                return
            newer = preview.poll()
            if newer is not None:
                title = content.title or f"{name_of(folder)}: {preview_title(newer)}"
                shown = replace(content, title=title, path=None, live=True)
                server.files = {INDEX: scene_page(newer, shown)}
        except UserError as error:  # a preview that cannot be shown; the next may
            print(f"snerg-view: warning: {error}", flush=True)
