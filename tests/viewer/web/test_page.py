"""What stands in the page: small, closed to the network, and with nothing of a pack's text as markup or as shader."""

import base64
import hashlib
import json
import re
import zlib
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import pytest

from baker.commands import pack as command
from scenepack import load_pack, save_pack
from scenepack.pack import Pack
from tests.viewer.rendering.shapes import surroundings_pack
from tests.viewer.web.browser import Browser
from viewer.core import annotations as notes
from viewer.core.annotations import KEY, Annotations, Bookmark, annotations_to_json
from viewer.web.description import PageContent
from viewer.web.page import scene_page

MOST_BYTES, MOST_OF_DEMO = 60_000, 9_000_000
HOSTILE = (
    "</script><script>window.broken = 1</script>",
    "<!--<script>",
    "--><img src=x onerror='window.broken = 1'>",
    "{{data}} {{script}} \\u003c ${1} \"'&lt;&amp;",
    "#version 300 es\nvoid main() {}",
    "https://example.org/\u2028\u2029\x00\x1b[31m",
    "</title></style>" * 400,
)


class Tags(HTMLParser):
    """The tags of a page, in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, tuple[tuple[str, str | None], ...]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, tuple((name, value) for name, value in attrs if name != "content")))


def described(html: bytes) -> dict:
    """The description in a page."""
    packed = re.search(rb'id="scene">([^<]*)<', html)
    assert packed is not None
    return json.loads(zlib.decompress(base64.b64decode(packed[1])))


def with_texts(pack: Pack, text: str) -> Pack:
    view = {"name": text, "eye": [0, 2, 2], "target": [0, 0, 0], "up": "y", "fov": 40, "text": text}
    spoilt = {"bookmarks": [view, {**view, "up": text}, {**view, "eye": text}, text], "scale": text}
    return pack.with_metadata(**{KEY: spoilt, "version": text, text: text, "provenance": {text: text}})


def test_the_page_without_its_pack_is_small() -> None:
    # Contracted packs have the longest shaders; the weights of a view MLP, 9 kB, are the pack's.
    html = scene_page(surroundings_pack(side=42, diffuse=True), PageContent("x"))
    data = re.findall(rb'class="data">([^<]*)<', html)
    assert data and len(html) - sum(map(len, data)) < MOST_BYTES


@pytest.mark.slow
def test_the_demos_page_is_small(demo: Path) -> None:
    assert len(scene_page(load_pack(demo), PageContent("demo"))) < MOST_OF_DEMO


def test_the_policy_allows_the_pages_own_script_and_nothing_from_elsewhere(shapes: Pack) -> None:
    html = scene_page(shapes, PageContent("x")).decode()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', html)
    assert policy is not None and "default-src 'none'" in policy[1] and "unsafe" not in policy[1]
    assert not re.search(r"\b(?:https?:)?//[a-z]", re.sub(r"<script.*", "", html, flags=re.S))
    loader, scene = re.search(r"<script>(.*?)</script>", html, re.S), described(html.encode())
    assert loader is not None
    unsafe = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(|new Function|https?://"
    for text in (html, scene["script"], scene["worker"]):
        assert not re.search(unsafe, text)
    hashes = re.findall(r"'sha256-([^']+)'", policy[1].partition("script-src")[2].partition(";")[0])
    digests = [hashlib.sha256(text.encode()).digest() for text in (loader[1], scene["script"])]
    assert [base64.b64decode(each) for each in hashes] == digests


def test_text_of_a_pack_adds_no_markup_and_no_shader(shapes: Pack) -> None:
    plain = scene_page(shapes, PageContent("x"))
    for text in HOSTILE:
        html = scene_page(with_texts(shapes, text), PageContent(text))
        assert Tags(html.decode()).tags == Tags(plain.decode()).tags, text
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
    scene = described(to.read_bytes())
    assert scene["title"] == "A <b>title</b>" and b"<b>" not in to.read_bytes()
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
    scene = described((tmp_path / "a.html").read_bytes())
    assert [view["name"] for view in scene["camera"]["bookmarks"]] == ["Kept"] and scene["credits"] == "by me"
    assert command.main([*words, "--pose", "1,2"]) == 2
