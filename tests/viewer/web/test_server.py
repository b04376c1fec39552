"""snerg-view --serve: one page at one address, and nothing else."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest

from console import UserError
from scenepack import save_pack
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.web.browser import Browser
from viewer.commands import view
from viewer.commands.view import SERVED_ON, _with_port
from viewer.web.server import PageServer

ROOT = Path(__file__).parents[3]
PAGE = b"<!doctype html><title>x</title>"


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer(PAGE, "127.0.0.1", 0) as one:
        thread = threading.Thread(target=one.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield one
        one.shutdown()
        thread.join()


def ask(server: PageServer, path: str, method: str = "GET") -> tuple[int, bytes, dict[str, str]]:
    connection = HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    connection.putrequest(method, path, skip_accept_encoding=True)
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body, {name.lower(): value for name, value in answer.getheaders()}


def test_the_page_is_at_its_address(server: PageServer) -> None:
    status, body, headers = ask(server, server.path)
    assert (status, body) == (200, PAGE)
    assert headers["referrer-policy"] == "no-referrer" and headers["cache-control"] == "no-store"
    assert ask(server, server.path, "HEAD")[:2] == (200, b"")
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{22}/", server.address)
    assert server.path != PageServer(PAGE, "127.0.0.1", 0).path


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_nothing_else_is(server: PageServer, method: str) -> None:
    token = server.path
    for path in ("/", "/etc/passwd", token[:-1], token + "x", f"{token}../{token}", f"{token}../../../etc/passwd", token + "?a",
                 f"{token}%2e%2e/%2e%2e/etc/passwd", "/../../../../etc/passwd", f"/.{token}", "/%c3%a9/"):  # fmt: skip
        status, body, _ = ask(server, path, method)
        assert status == 404 and b"root:" not in body and token.encode() not in body, path
    assert ask(server, token, "POST")[0] == 501


def test_a_port_that_is_taken_or_none_is_told(server: PageServer) -> None:
    with pytest.raises(UserError, match="cannot be listened on"):
        PageServer(PAGE, "127.0.0.1", server.server_address[1])
    with pytest.raises(UserError, match="out of range"):
        PageServer(PAGE, "127.0.0.1", 70000)


def test_the_port_may_be_left_out() -> None:
    assert _with_port(["--serve", "a.zip"]) == [f"--serve={SERVED_ON}", "a.zip"]
    assert _with_port(["a.zip", "--serve"]) == ["a.zip", f"--serve={SERVED_ON}"]
    assert _with_port([]) == [] and _with_port(["a.zip"]) == ["a.zip"]
    assert _with_port(["--serve", "80", "a.zip"]) == ["--serve", "80", "a.zip"]


def test_what_is_no_pack_is_not_served(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert view.main([str(tmp_path / "gone"), "--serve"]) == 2
    assert "gone" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_serves_a_pack_until_it_is_interrupted(browser: Browser, tmp_path: Path) -> None:
    save_pack(shapes_pack(42), tmp_path / "shapes")
    words = [sys.executable, "-m", "viewer.commands.view", str(tmp_path / "shapes"), "--serve", "0"]
    with subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.PIPE, text=True, env={**os.environ, "DISPLAY": ""}
    ) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        browser.open(address)
        assert browser.evaluate("snerg.ready.then(() => snerg.scene.title)") == "shapes"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
