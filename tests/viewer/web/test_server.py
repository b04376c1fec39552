"""snerg-view --serve: one page at one address, and nothing else."""

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
from tests.viewer.waiting import until
from tests.viewer.web.browser import Browser
from viewer.commands import view
from viewer.features.making.make_plan import PREVIEW_FILE
from viewer.web.description import PageContent
from viewer.web.page import INDEX, PageServer, serve

ROOT = Path(__file__).parents[3]
PAGE = b"<!doctype html><title>x</title>"
FILES = {INDEX: PAGE, "scene-42.bin": b"data"}


@pytest.fixture
def server() -> Iterator[PageServer]:
    with PageServer(FILES, "127.0.0.1", 0) as one:
        thread = threading.Thread(target=one.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield one
        one.shutdown()
        thread.join()


def ask(server: PageServer, path: str, method: str = "GET", tag: str = "") -> tuple[int, bytes, dict[str, str]]:
    connection = HTTPConnection("127.0.0.1", server.server_address[1], timeout=20)
    connection.putrequest(method, path, skip_accept_encoding=True)
    connection.putheader("If-None-Match", tag)
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
    assert server.path != PageServer(FILES, "127.0.0.1", 0).path


def test_files_beside_it_are_served_by_their_exact_names_and_what_is_unchanged_is_not_sent_again(server):
    status, body, headers = ask(server, f"{server.path}scene-42.bin?1a2b")
    assert (status, body, headers["content-type"]) == (200, b"data", "application/octet-stream")
    assert ask(server, f"{server.path}scene-43.bin")[0] == ask(server, "/scene-42.bin")[0] == 404
    tag = ask(server, server.path)[2]["etag"]
    assert ask(server, server.path, tag=tag)[:2] == (304, b"")
    server.files = {INDEX: b"newer"}
    assert ask(server, server.path, tag=tag)[:2] == (200, b"newer")


@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_nothing_else_is(server: PageServer, method: str) -> None:
    token = server.path
    for path in ("/", "/etc/passwd", token[:-1], token + "x", f"{token}../{token}", f"{token}../../../etc/passwd",
                 f"{token}%2e%2e/%2e%2e/etc/passwd", "/../../../../etc/passwd", f"/.{token}", "/%c3%a9/"):  # fmt: skip
        status, body, _ = ask(server, path, method)
        assert status == 404 and b"root:" not in body and token.encode() not in body, path
    assert ask(server, token, "POST")[0] == 501


def test_a_port_that_is_taken_or_none_is_told(server: PageServer) -> None:
    with pytest.raises(UserError, match="cannot be listened on"):
        PageServer(FILES, "127.0.0.1", server.server_address[1])
    with pytest.raises(UserError, match="out of range"):
        PageServer(FILES, "127.0.0.1", 70000)


def test_what_is_no_pack_is_not_served_and_the_port_may_be_left_out(refused, tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    said = {refused(view.main, *words) for words in ((gone, "--serve"), ("--serve", gone), ("--serve", 80, gone))}
    assert len(said) == 1 and str(gone) in said.pop()


@pytest.mark.slow
def test_the_command_serves_a_pack_until_it_is_interrupted(browser: Browser, tmp_path: Path) -> None:
    save_pack(shapes_pack(42), tmp_path / "shapes")
    words = [sys.executable, "-m", "viewer.commands.view", str(tmp_path / "shapes"), "--serve", "0"]
    environment = {**os.environ, "DISPLAY": ""}
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        browser.open(address)
        assert browser.evaluate("snerg.ready.then(() => snerg.scene.title)") == "shapes"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130


@pytest.mark.slow
def test_a_page_of_a_run_shows_its_newest_preview_keeps_the_camera_and_ends_with_the_pack(
    browser, tmp_path, monkeypatch
):
    monkeypatch.setattr("viewer.web.page.LOOK_EVERY_S", 0.1)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text("{}")
    served: list[PageServer] = []
    begin = PageServer.serve_forever
    monkeypatch.setattr(PageServer, "serve_forever", lambda self, *_: (served.append(self), begin(self, 0.05)))

    def preview(steps: int, side: int) -> None:
        made = shapes_pack(side).with_metadata(provenance={"steps": steps, "of_steps": 900})
        save_pack(made, tmp_path / "new.zip")
        (tmp_path / "new.zip").replace(tmp_path / PREVIEW_FILE)

    thread = threading.Thread(target=serve, args=(tmp_path / "run", "127.0.0.1", 0, PageContent("")))
    thread.start()
    try:
        until(lambda: bool(served))
        browser.open(served[0].address)
        assert "Waiting" in browser.evaluate("document.body.textContent")
        preview(100, 28)
        browser.until("globalThis.snerg?.level")
        assert browser.evaluate("document.title").endswith("preview after 100 steps")
        browser.evaluate("snerg.ready.then(() => snerg.camera.orbit(0.3, 0.1))")
        browser.evaluate("snerg.camera.shown = snerg.camera.goal; 0")
        before = browser.evaluate("snerg.camera.view(0)")
        preview(200, 42)
        browser.until("snerg.scene.title.endsWith('after 200 steps') && snerg.level.uniforms.grid_size[0] === 42")
        assert browser.evaluate("snerg.camera.view(0)") == before
        save_pack(shapes_pack(42), tmp_path / "pack")
        browser.until("document.title === 'run' && !snerg.scene.live && snerg.resting")
        assert browser.evaluate("snerg.camera.view(0)") == before
    finally:
        served[0].shutdown()
        thread.join()
