"""The page of a pack over HTTP until it is interrupted; of a run that trains, its newest preview, and in the end its pack.

It is for who has its address, of which a random token is part. Nothing is served but the page's files, from memory.
"""

import hashlib
import hmac
import secrets
import threading
from collections.abc import Mapping
from dataclasses import replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from console import UserError
from scenepack.reader import load_pack
from viewer.core.files import kind_of, pack_in
from viewer.core.state import name_of
from viewer.features.making.make_job import FileWatch, preview_title, read_preview
from viewer.features.making.make_plan import PREVIEW_FILE
from viewer.web.description import PageContent, with_annotations
from viewer.web.page import INDEX, scene_files, scene_page

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
        kind = "text/html; charset=utf-8" if name == INDEX else "application/octet-stream"
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
    files = _files(pack_in(path), content, name_of(path)) if kind == "pack" else {INDEX: WAITING}
    ended = threading.Event()
    with PageServer(files, host, port) as server:
        print(f"{server.address}\nCtrl-C ends it.", flush=True)
        if kind == "run":
            threading.Thread(target=_follow, args=(server, path, content, ended), daemon=True).start()
        try:
            server.serve_forever()
        finally:
            ended.set()


def _files(path: Path, content: PageContent, name: str) -> dict[str, bytes]:
    shown = replace(content, title=content.title or name)
    return scene_files(with_annotations(load_pack(path), path), shown)


def _follow(server: PageServer, run: Path, content: PageContent, ended: threading.Event) -> None:
    """Serves each newer preview, as one file, so that no page is of two; the pack once it is there."""
    folder = run.parent if (run / "config.json").is_file() else run
    preview, pack = FileWatch(folder / PREVIEW_FILE, read_preview), folder / "pack"
    while not ended.wait(LOOK_EVERY_S):
        try:
            if pack.is_dir() and kind_of(pack) == "pack":
                server.files = _files(pack, content, name_of(run))
                return
            newer = preview.poll()
            if newer is not None:
                title = content.title or f"{name_of(folder)}: {preview_title(newer)}"
                shown = replace(content, title=title, path=None, live=True)
                server.files = {INDEX: scene_page(newer, shown)}
        except UserError as error:  # a preview that cannot be shown; the next may
            print(f"snerg-view: warning: {error}", flush=True)
