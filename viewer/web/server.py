"""A page over HTTP, for who has its address: a random token is part of it. Nothing is served but its files, from memory."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from console import UserError
from viewer.web.page import INDEX

HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
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
            remedy = "choose another port: --serve PORT"
            raise UserError(
                "cannot be listened on", where=f"{host}:{port}", found=error.strerror, remedy=remedy
            ) from error

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
        self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def _answer(self, *, body: bool) -> None:
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
        if body and not unchanged:
            self.wfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the address holds the token."""
