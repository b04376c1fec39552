"""The page draws what the desktop draws, in every mode, of packs of every kind, and coarsely at first."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baker.commands import pack as command
from scenepack import save_pack
from scenepack.pack import Pack
from tests.viewer.rendering.golden_variants import PACKS, camera_for
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.web.browser import Browser
from tests.viewer.web.conftest import page_picture, served
from viewer.core.annotations import KEY, Annotations, annotations_to_json
from viewer.features.display.display import backdrop
from viewer.rendering.camera import ViewCamera
from viewer.rendering.gpu_scene import half_resolution
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import Look, Mode, RenderSettings
from viewer.web import description
from viewer.web.description import MODES, PageContent, describe
from viewer.web.page import scene_page

SIZE = (160, 120)
DIFFERS, SHARE = 2, 0.001  # of 255; of the channels that may differ by more
WHITE = "background: [1, 1, 1]"


def assert_same(page: np.ndarray, desktop: np.ndarray, what: str) -> None:
    difference = np.abs(page.astype(int) - desktop)
    share = float(np.mean(difference > DIFFERS))
    assert share <= SHARE, f"{what}: {100 * share:.3f} % of the channels differ, the worst by {difference.max()}/255"
    assert len(np.unique(page)) > 3, f"{what}: nothing is seen"


def assert_same_as_desktop(browser: Browser, pack: Pack, name: str) -> None:
    """The open page draws what the desktop draws of the pack, from two sides."""
    with OffscreenRenderer(pack) as desktop:
        for azimuth in (205, 30):
            camera = ViewCamera.orbit(pack, azimuth, 22, size=SIZE)
            assert_same(page_picture(browser, camera), desktop.render(camera), name)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PACKS, "diffuse"])
def test_every_mode_of_every_kind_of_pack_looks_the_same(name: str, show) -> None:
    pack = shapes_pack(diffuse=True) if name == "diffuse" else PACKS[name]()
    browser, camera = show(pack), camera_for(pack).resized(*SIZE)
    modes: list[Mode] = [
        mode for mode in MODES if pack.view_mlp is not None or mode not in ("features", "view-dependent")
    ]
    assert browser.evaluate("Object.keys(snerg.scene.shaders.modes)") == modes
    gradient = backdrop("gradient", "dark")
    cases = [
        *((camera, f"mode: '{mode}', {WHITE}", RenderSettings(mode=mode)) for mode in modes),
        (camera, "background: [0.1, 0.2, 0.3]", RenderSettings(background=(0.1, 0.2, 0.3))),
        (camera, "background: null", RenderSettings(backdrop=gradient)),
    ]
    if not pack.ndc:
        cases.append((replace(camera, near=2.6), WHITE, RenderSettings()))
        cases.append((ViewCamera.orbit(pack, 300, 8, 0.4, size=SIZE), WHITE, RenderSettings()))  # amid the content
    if pack.contraction is not None:
        cases.append((camera, f"surroundings: false, {WHITE}", RenderSettings(surroundings=False)))
    with OffscreenRenderer(pack) as desktop:
        for seen, settings, wanted in cases:
            page = page_picture(browser, seen, f"{{{settings}}}")
            assert_same(page, desktop.render(seen, wanted), f"{name}, {settings}")
        look = Look(0.7, 0.4, -0.2, 1.3)
        again = show(pack.with_metadata(**{KEY: annotations_to_json(Annotations(look=look))}))
        for mode in ("normal", "depth"):
            page = page_picture(again, camera, f"{{mode: '{mode}', {WHITE}}}")
            expected = desktop.render(camera, RenderSettings(mode=mode, look=look))
            assert_same(page, expected, f"{name}, {mode} with a look")
    assert not browser.problems


# A coarse picture comes first, from files beside the page, too, and stays where there can be no more


LEVEL = "Math.max(...snerg.level.uniforms.grid_size)"
FACTS = "document.getElementById('facts').textContent"


@pytest.fixture(scope="module")
def levels() -> Iterator[None]:
    """Even small packs have a coarse level."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(description, "COARSE", 20_000)
        patch.setattr(description.renderer, "LEAST_HALVED", 42)
        yield


class Files(dict[str, bytes]):
    """Of a folder, by name. asked: in this order. One whose name is `held` waits for `release`."""

    def __init__(self, folder: Path) -> None:
        super().__init__({path.name: path.read_bytes() for path in folder.iterdir()})
        self.held, self.release, self.asked = "", threading.Event(), []

    def get(self, key: str, default: Any = None) -> Any:
        self.asked.append(key)
        if key == self.held:
            self.release.wait(120)
        return super().get(key, default)


@pytest.fixture(scope="module")
def folder(levels: None, shapes: Pack, tmp_path_factory: pytest.TempPathFactory) -> Path:
    parent = tmp_path_factory.mktemp("folder")
    save_pack(shapes, parent / "shapes")
    assert command.main(["export", str(parent / "shapes"), "--to", f"{parent / 'site'}/"]) == 0
    assert sorted(path.name for path in (parent / "site").iterdir()) == ["index.html", "scene-21.bin", "scene-42.bin"]
    return parent / "site"


@pytest.mark.slow
def test_a_served_folder_shows_a_coarse_picture_first_and_stays_at_it_where_the_rest_is_gone(browser, folder, shapes):
    browser.resize(*SIZE)
    files = Files(folder)
    files.held = "scene-42.bin"
    with served(files) as server:
        browser.open(server.address)
        browser.until("snerg.level && snerg.resting")
        assert browser.evaluate(LEVEL) == 21 and "half resolution" in browser.evaluate(FACTS)
        assert_same_as_desktop(browser, half_resolution(shapes), "coarse")
        files.release.set()
        browser.evaluate("snerg.ready.then(() => true)")
        assert browser.evaluate(LEVEL) == 42 and browser.evaluate(FACTS) == "42 × 42 × 42 voxels"
        assert_same_as_desktop(browser, shapes, "whole")
        assert files.asked == ["index.html", "scene-21.bin", "scene-42.bin"]
        del files["scene-42.bin"]
        browser.open(server.address)
        browser.evaluate("snerg.ready.then(() => true)")
        assert browser.evaluate(LEVEL) == 21 and "the server answers 404" in browser.evaluate(FACTS)


@pytest.mark.slow
def test_a_folder_opened_from_disk_says_why_it_cannot_be_shown(browser: Browser, folder: Path) -> None:
    browser.open((folder / "index.html").as_uri())
    assert "web server" in browser.evaluate("snerg.ready.then(() => '', (error) => error.message)")
    assert "http.server" in browser.evaluate("document.getElementById('notice').textContent")


LACKS = {
    "takes 63": "const get = WebGL2RenderingContext.prototype.getParameter;"
    "WebGL2RenderingContext.prototype.getParameter = function (name) { return name === 0x8073 ? LIMIT : get.call(this, name) }",
    "not enough graphics memory": "const store = WebGL2RenderingContext.prototype.texStorage3D; let full = false;"
    "WebGL2RenderingContext.prototype.texStorage3D = function (...words) {"
    "  if (Math.max(...words.slice(3)) > LIMIT) full = true; else store.apply(this, words) };"
    "const error = WebGL2RenderingContext.prototype.getError;"
    "WebGL2RenderingContext.prototype.getError = function () {"
    "  const was = full; full = false; return was ? 0x505 : error.call(this) }",
    "could not hold more": "const store = WebGL2RenderingContext.prototype.texStorage3D;"
    "WebGL2RenderingContext.prototype.texStorage3D = function (...words) { store.apply(this, words);"
    "  if (Math.max(...words.slice(3)) > LIMIT) this.getExtension('WEBGL_lose_context').loseContext() }",
}


@pytest.mark.slow
@pytest.mark.usefixtures("levels")
@pytest.mark.parametrize("words", LACKS)
def test_a_device_that_cannot_hold_the_scene_shows_it_at_half_resolution_and_says_so(words, browser, shapes, tmp_path):
    file = tmp_path / "scene.html"
    file.write_bytes(scene_page(shapes, PageContent("x")))
    about, _ = describe(shapes, PageContent("x"), lambda share: None)
    coarse, whole = (max(*level["atlas"]["size"], *level["skip_grid"]["size"]) for level in about["levels"])
    assert coarse < whole
    browser.resize(*SIZE)
    with browser.before_scripts(LACKS[words].replace("LIMIT", str(whole - 1))):
        browser.open(file.as_uri())
        browser.until(f"globalThis.snerg?.level && {FACTS}.includes('{words.replace('63', str(whole - 1))}')")
        assert browser.evaluate(LEVEL) == 21 and "Shown at half resolution" in browser.evaluate(FACTS)
        assert_same_as_desktop(browser, half_resolution(shapes), words)


@pytest.mark.usefixtures("levels")
def test_progress_of_an_export_goes_from_nothing_to_all_of_it(shapes: Pack) -> None:
    shares: list[float] = []
    about, data = describe(shapes, PageContent("x"), shares.append)
    assert [level["bytes"] for level in about["levels"]] == [len(each) for each in data.values()]
    assert shares == sorted(shares) and len(shares) > 1 and shares[-1] == pytest.approx(1)
