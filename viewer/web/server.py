"""A page over HTTP, for who has its address: a random token is part of it, and nothing else is served."""

from __future__ import annotations

import hmac
import secrets
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from console import UserError

HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
PATIENCE_S = 60.0  # for a connection that says nothing


class PageServer(ThreadingHTTPServer):
    """Serves `page` at `address` while serve_forever() runs. port: 0 for any that is free. UserError where it cannot listen."""

    daemon_threads = True

    def __init__(self, page: bytes, host: str, port: int) -> None:
        if not 0 <= port <= 65535:
            raise UserError("is out of range", where="--serve", expected="a port, 0 to 65535", found=port)
        self.page, self.path = page, f"/{secrets.token_urlsafe(16)}/"
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
        if not hmac.compare_digest(self.path.encode("latin-1", "replace"), self.server.path.encode()):
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        for name, value in {**HEADERS, "Content-Length": str(len(self.server.page))}.items():
            self.send_header(name, value)
        self.end_headers()
        if body:
            self.wfile.write(self.server.page)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the address holds the token."""
