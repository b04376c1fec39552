"""A browser for all tests of the page, and pages of packs on disk."""

import base64
import io
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenepack.pack import Pack
from tests.viewer.conftest import installed
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.web.browser import Browser, executable
from viewer.rendering.camera import ViewCamera
from viewer.web.description import PageContent
from viewer.web.page import PageServer, scene_page


@contextmanager
def served(files: Mapping[str, bytes]) -> Iterator[PageServer]:
    """A server of files on this computer."""
    with PageServer(files, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if not executable():
        installed("chromium")
    with Browser(tmp_path_factory.mktemp("chromium")) as one:
        yield one


@pytest.fixture(scope="session")
def shapes() -> Pack:
    """Coarser than the renderer's tests have it."""
    return shapes_pack(42)


@pytest.fixture
def show(browser: Browser, tmp_path: Path) -> Callable[..., Browser]:
    """Opens the page of a pack from disk, and waits until it is drawn."""

    def opened(pack: Pack, content: PageContent | None = None, size: tuple[int, int] = (320, 240)) -> Browser:
        file = tmp_path / "scene.html"
        file.write_bytes(scene_page(pack, content or PageContent("A scene")))
        browser.problems.clear()
        browser.resize(*size)
        browser.open(file.as_uri())
        browser.evaluate("snerg.ready.then(() => true)")
        browser.until("snerg.resting")
        return browser

    return opened


def page_picture(browser: Browser, camera: ViewCamera, settings: str = "{background: [1, 1, 1]}") -> np.ndarray:
    """What the page draws for a camera, uint8 [height, width, 3]. settings: a JavaScript object."""
    axes, eye = camera.grid_T_camera[:3, :3].T.tolist(), camera.position.tolist()
    fov = float(np.degrees(2 * np.arctan(0.5 * camera.height / camera.fy)))
    view = f"{{axes: {axes}, eye: {eye}, fov: {fov!r}, near: {camera.near!r}}}"
    drawn = browser.evaluate(f"""(() => {{
        const canvas = document.createElement("canvas");
        [canvas.width, canvas.height] = [{camera.width}, {camera.height}];
        const picture = snerg.picture({view}, {settings}, canvas.width, canvas.height);
        canvas.getContext("2d").putImageData(picture, 0, 0);
        return canvas.toDataURL("image/png").split(",")[1];
    }})()""")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(drawn)), formats=["PNG"]).convert("RGB"))
