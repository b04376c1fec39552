"""The page's worker brings back the atlas, from chunks and from films, and tells what is damaged."""

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenepack import load_pack, save_pack
from scenepack.codecs.films import AvifCodec
from scenepack.pack import Pack
from scenepack.piece_files import follows_grid
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.web.browser import Browser
from tests.viewer.web.test_pictures import assert_same_as_desktop
from viewer.web import atlas_stream, description
from viewer.web.atlas_stream import film_in
from viewer.web.description import PageContent, describe
from viewer.web.page import scene_page

# Workers do not see what a page's script takes away.
NO_DECODER = """const Blobs = Blob; globalThis.Blob = function (parts, options) {
    const text = options?.type === "text/javascript" ? "delete self.VideoDecoder;" : "";
    return new Blobs(text ? [text, ...parts] : parts, options); };"""


@pytest.mark.slow
@pytest.mark.parametrize("noisy", [False, True])
def test_an_atlas_in_several_chunks_and_with_padding_that_copies_nothing_is_the_desktops(show, monkeypatch, noisy):
    monkeypatch.setattr(atlas_stream, "BLOCKS_A_CHUNK", 7)  # the last of them is smaller
    pack, rng = shapes_pack(), np.random.default_rng(3)
    if noisy:  # as packs from elsewhere may have it
        noise = rng.integers(0, 255, pack.atlas_rgba.shape, np.uint8)
        pack = replace(pack, atlas_rgba=np.where(rng.random(noise.shape) < 0.01, noise, pack.atlas_rgba))
    assert all(follows_grid(pack, atlas) for atlas in pack.atlases) != noisy
    assert_same_as_desktop(show(pack), pack, "noisy" if noisy else "chunks")


@pytest.fixture
def filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Pack], PageContent]:
    """Writes an AVIF pack that has a coarse level."""
    monkeypatch.setattr(description, "COARSE", 20_000)
    monkeypatch.setattr(description.renderer, "LEAST_HALVED", 28)
    monkeypatch.setattr(AvifCodec, "planes", lambda self, layout, block_size: block_size)  # several pieces

    def write(pack: Pack) -> PageContent:
        save_pack(pack, tmp_path / "avif", codec="avif")
        return PageContent("test", source=tmp_path / "avif")

    return write


@pytest.mark.slow
@pytest.mark.parametrize("diffuse", [False, True])
def test_an_avif_pack_is_that_of_the_desktop(diffuse, show, filmed):
    content = filmed(shapes_pack(diffuse=diffuse))
    assert content.source is not None
    pack = load_pack(content.source)
    about, _ = describe(pack, content, lambda share: None)
    (coarse, whole), features = about["levels"], not diffuse
    assert "pieces" not in coarse["atlas"] and len(whole["atlas"]["pieces"]) > 1
    assert {len(piece["films"]) for piece in whole["atlas"]["pieces"]} == {4 if features else 2}
    browser = show(pack, content)
    browser.until("Math.max(...snerg.level.uniforms.grid_size) === 70")
    assert_same_as_desktop(browser, pack, "films")


@pytest.mark.slow
def test_an_avif_pack_stays_coarse_where_the_browser_decodes_no_films(browser, tmp_path, filmed):
    content = filmed(shapes_pack())
    assert content.source is not None
    page = scene_page(load_pack(content.source), content).decode("utf-16")
    start = page.rindex('class="data">') + 13
    middle = (start + page.index("</script>", start)) // 2
    damaged = page[:middle] + "A" * 400 + page[middle + 400 :]
    for text, script, words in ((page, NO_DECODER, "does not decode AV1"), (damaged, "", "damaged")):
        file = tmp_path / "films.html"
        file.write_text(text, encoding="utf-16")
        with browser.before_scripts(script):
            browser.open(file.as_uri())
            browser.evaluate("snerg.ready.then(() => true)")
        facts = browser.evaluate("document.getElementById('facts').textContent")
        assert "Shown at a quarter of its resolution" in facts and words in facts


@pytest.mark.slow
def test_damaged_data_are_told_and_never_shown(browser: Browser, tmp_path: Path) -> None:
    page = scene_page(shapes_pack(), PageContent("test")).decode("utf-16")
    start = page.index('class="data">') + 13
    middle = start + (page.index("</script>", start) - start) // 2
    for damaged in (page[:middle] + "AAAAAAAA" + page[middle + 8 :], page[:start] + page[middle:]):
        file = tmp_path / "damaged.html"
        file.write_text(damaged, encoding="utf-16")
        browser.open(file.as_uri())
        assert browser.evaluate("snerg.ready.then(() => 'shown', () => 'refused')") == "refused"
        assert browser.evaluate("document.getElementById('notice').className") == "failed"
        assert "damaged" in browser.evaluate("document.getElementById('notice-text').textContent")


FRAMES = 5


def test_files_whose_samples_lie_otherwise_are_not_taken() -> None:
    avif = AvifCodec().film(np.random.default_rng(0).integers(0, 255, (FRAMES, 32, 48, 3), np.uint8), "rgb", 60)
    film = film_in(avif, FRAMES)
    assert film is not None and len(film.sizes) == FRAMES and film.codec.startswith("av01.1.")  # profile 1: 4:4:4
    assert film_in(avif, FRAMES + 1) is None and film_in(avif[:-1], FRAMES) is None and film_in(b"", FRAMES) is None

    def with_word(box: bytes, number: int, value: int) -> bytes:
        at = avif.index(box) + 8 + 4 * number
        return avif[:at] + struct.pack(">I", value) + avif[at + 4 :]

    for changed in (with_word(b"stsz", 0, 7), with_word(b"stsz", 2, 1 << 31), with_word(b"stco", 0, 2),
                    with_word(b"stco", 1, len(avif)), avif.replace(b"av1C", b"av2C")):  # fmt: skip
        assert film_in(changed, FRAMES) is None
