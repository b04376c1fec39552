"""The page: small, closed to the network, with nothing of a pack's text as markup or shader; and the server for it alone."""

import base64
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path

import pytest

from baker.commands import pack as command
from console import UserError
from scenepack import load_pack, save_pack
from scenepack.pack import Pack
from tests.viewer.rendering.shapes import shapes_pack, surroundings_pack
from tests.viewer.waiting import until
from tests.viewer.web.browser import Browser
from tests.viewer.web.conftest import served
from viewer.commands import view
from viewer.core import annotations as notes
from viewer.core.annotations import KEY, Annotations, Bookmark, annotations_to_json
from viewer.features.making.make_plan import PREVIEW_FILE
from viewer.web.description import PageContent
from viewer.web.page import INDEX, PageServer, scene_page, serve

MOST_BYTES, MOST_OF_DEMO = 110_000, 6_000_000
HOSTILE = (
    "</script><script>window.broken = 1</script>",
    "<!--<script>",
    "--><img src=x onerror='window.broken = 1'>",
    "{{data}} {{script}} \\u003c ${1} \"'&lt;&amp;",
    "#version 300 es\nvoid main() {}",
    "https://example.org/\u2028\u2029\x00\x1b[31m",
    "</title></style>" * 400,
)


def tags(html: str) -> list[str]:
    """Of a page, in order, without their contents and hashes."""
    return re.findall(r"<[a-z!/][^>]*>", re.sub(r'content="[^"]*"', "", html))


def described(html: str) -> dict:
    """The description in a page."""
    packed = re.search(r'id="scene">([^<]*)<', html)
    assert packed is not None
    return json.loads(zlib.decompress(base64.b64decode(packed[1])))


def with_texts(pack: Pack, text: str) -> Pack:
    view = {"name": text, "eye": [0, 2, 2], "target": [0, 0, 0], "up": "y", "fov": 40, "text": text}
    spoilt = {"bookmarks": [view, {**view, "up": text}, {**view, "eye": text}, text], "scale": text}
    return pack.with_metadata(**{KEY: spoilt, "version": text, text: text, "provenance": {text: text}})


def test_the_page_without_its_pack_is_small() -> None:
    # Contracted packs have the longest shaders; the weights of a view MLP, 9 kB, are the pack's.
    html = scene_page(surroundings_pack(side=42, diffuse=True), PageContent("x"))
    data = re.findall(r'class="data">([^<]*)<', html.decode("utf-16"))
    assert data and len(html) - 2 * sum(map(len, data)) < MOST_BYTES


@pytest.mark.slow
def test_the_demos_page_is_small(demo: Path) -> None:
    assert len(scene_page(load_pack(demo), PageContent("demo"))) < MOST_OF_DEMO


def test_the_policy_allows_the_pages_own_script_and_nothing_from_elsewhere(shapes: Pack) -> None:
    html = scene_page(shapes, PageContent("x")).decode("utf-16")
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', html)
    assert policy is not None and "default-src 'none'" in policy[1] and "unsafe" not in policy[1]
    assert not re.search(r"\b(?:https?:)?//[a-z]", re.sub(r"<script.*", "", html, flags=re.S))
    loader, scene = re.search(r"<script>(.*?)</script>", html, re.S), described(html)
    assert loader is not None
    unsafe = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|new Function|https?://"
    for text in (html, scene["script"], scene["worker"]):
        assert not re.search(unsafe, text)
    hashes = re.findall(r"'sha256-([^']+)'", policy[1].partition("script-src")[2].partition(";")[0])
    digests = [hashlib.sha256(text.encode()).digest() for text in (loader[1], scene["script"])]
    assert [base64.b64decode(each) for each in hashes] == digests


def test_text_of_a_pack_adds_no_markup_and_no_shader(shapes: Pack) -> None:
    plain = scene_page(shapes, PageContent("x")).decode("utf-16")
    for text in HOSTILE:
        html = scene_page(with_texts(shapes, text), PageContent(text)).decode("utf-16")
        assert tags(html) == tags(plain), text
        assert described(html)["shaders"] == described(plain)["shaders"], text
        assert [view["fov"] for view in described(html)["camera"]["bookmarks"]] == [40], text


@pytest.mark.slow
def test_hostile_text_is_shown_as_text(show: Callable[..., Browser], shapes: Pack) -> None:
    text = "".join(HOSTILE[:3])
    browser = show(with_texts(shapes, text), PageContent(text))
    assert browser.evaluate("window.broken") is None and not browser.problems
    shown = browser.evaluate("document.getElementById('title').textContent")
    assert shown and text.startswith(shown.removesuffix("…")) and "<script>" in shown
    assert "<script>" in browser.evaluate("document.querySelector('#bookmarks button').textContent")
    browser.evaluate("document.querySelector('#bookmarks button').click()")
    assert "<script>" in browser.evaluate("document.getElementById('note-text').textContent")
    assert browser.evaluate("window.broken") is None and not browser.problems


@pytest.mark.slow
def test_what_a_browser_lacks_is_told_in_words(browser: Browser, shapes: Pack, tmp_path: Path) -> None:
    file = tmp_path / "scene.html"
    file.write_bytes(scene_page(shapes, PageContent("x")))
    lacks = {
        "WebGL 2": "HTMLCanvasElement.prototype.getContext = () => null",
        "this device takes 64": "const get = WebGL2RenderingContext.prototype.getParameter;"
        "WebGL2RenderingContext.prototype.getParameter = function (name) { return name === 0x8073 ? 64 : get.call(this, name) }",
        "too old": "delete window.DecompressionStream",
    }
    for words, script in lacks.items():
        with browser.before_scripts(script):
            browser.open(file.as_uri())
            assert browser.evaluate("snerg.ready.then(() => '', (error) => error.message)").count(words) == 1
            assert words in browser.evaluate("document.getElementById('notice').textContent")


def test_the_command_writes_a_page_and_names_what_it_cannot(tmp_path: Path, capsys, shapes: Pack) -> None:
    folder, to = tmp_path / "shapes", tmp_path / "scene.html"
    save_pack(shapes, folder)
    words = ["--to", str(to), "--title", "A <b>title</b>", "--crop=-1,-1,-1,0,1,1"]
    assert command.main(["export", str(folder), *words]) == 0
    assert "a web page" in capsys.readouterr().out
    html = to.read_text(encoding="utf-16")
    scene = described(html)
    assert scene["title"] == "A <b>title</b>" and "<b>" not in html
    assert scene["levels"][0]["box"] == [[0, 0, 0], [21, 42, 42]]
    for words, complaint in (
        (["--to", str(tmp_path / "a.html"), "--kind", "mesh"], "cannot hold mesh"),
        (["--to", str(tmp_path / "a.glb"), "--title", "x"], "of web pages alone"),
        (["--to", str(tmp_path / "b.html"), "--path", str(folder / "scene_params.json")], "is not a camera path"),
    ):
        assert command.main(["export", str(folder), *words]) == 2
        assert complaint in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.html", "shapes"]


def test_bookmarks_of_a_zipped_pack_come_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shapes: Pack) -> None:
    save_pack(shapes, tmp_path / "shapes.zip")
    pack, kept = load_pack(tmp_path / "shapes.zip"), Annotations(bookmarks=(Bookmark("Kept", (0, 2, 2), (0, 0, 0)),))
    monkeypatch.setattr(notes, "default_folder", lambda: tmp_path)
    notes.file_for(pack, tmp_path).write_text(json.dumps(annotations_to_json(kept)))
    words = ["export", str(tmp_path / "shapes.zip"), "--to", str(tmp_path / "a.html")]
    assert command.main([*words, "--credits", "by me"]) == 0
    scene = described((tmp_path / "a.html").read_text(encoding="utf-16"))
    assert [view["name"] for view in scene["camera"]["bookmarks"]] == ["Kept"] and scene["credits"] == "by me"
    assert command.main([*words, "--pose", "1,2"]) == 2


# snerg-view --serve: one page at one address, and nothing else


ROOT = Path(__file__).parents[3]
PAGE = b"<!doctype html><title>x</title>"
FILES = {INDEX: PAGE, "scene-42.bin": b"data"}


@pytest.fixture
def server() -> Iterator[PageServer]:
    with served(FILES) as one:
        yield one


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
    words = [sys.executable, "-m", "snerg", "view", str(tmp_path / "shapes"), "--serve", "0"]
    environment = {**os.environ, "DISPLAY": ""}
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        browser.open(address)
        assert browser.evaluate("snerg.ready.then(() => snerg.scene.title)") == "shapes"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130


@pytest.mark.slow
def test_a_runs_page_shows_its_newest_preview_keeps_the_camera_and_ends_with_the_pack(browser, tmp_path, monkeypatch):
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
