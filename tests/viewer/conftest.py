"""A toy pack, the interface in a framebuffer, and a display of our own for the window's tests."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import moderngl
import numpy as np
import pytest

from scenepack import Pack, ViewMlp
from tests.scenepack.helpers import written
from tests.scenepack.volumes import BLENDER_FRAME, NDC_FRAME, cube_pack
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.scenes import photographed
from tests.viewer.screen import virtual_screen
from tests.viewer.waiting import not_none
from viewer.app.application import App
from viewer.core.files import demo_pack
from viewer.features.making import survey
from viewer.rendering.offscreen import create_context

SIDE, BLOCK = 44, 14

PACKAGES = {
    "Xvfb": "xvfb",
    "xdotool": "xdotool",
    "setxkbmap": "x11-xkb-utils",
    "chromium": "chromium",
}  # Debian's; scripts/ensure-gl.sh has them


def installed(what: str) -> str:
    """The path of a program. Without it, skips and names what to install; fails in CI, where nothing may be skipped silently."""
    if (path := shutil.which(what)) is not None:
        return path
    message = f"{what} is not installed: apt-get install {PACKAGES[what]}"
    if os.environ.get("CI"):
        pytest.fail(f"{message}; CI may not skip")
    pytest.skip(message)


def toy_pack(*, ndc: bool = False, view_mlp: bool = True, seed: int = 0) -> Pack:
    """A red ball on a green plate with a blue post, in the box of -1 … 1; features and a random view MLP."""
    rng = np.random.default_rng(seed)
    z, y, x = np.mgrid[:SIDE, :SIDE, :SIDE] * (2 / SIDE) - 1 + 1 / SIDE
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    rgba[(np.abs(y + 0.75) < 0.1) & (x**2 + z**2 < 0.7)] = (60, 170, 90, 255)
    rgba[(x**2 + (y + 0.25) ** 2 + z**2) < 0.16] = (210, 60, 50, 255)
    rgba[(np.abs(x - 0.5) < 0.08) & (np.abs(z) < 0.08) & (np.abs(y + 0.2) < 0.6)] = (60, 90, 220, 255)
    features = np.where(rgba[..., 3:] > 0, rng.integers(40, 200, (1, 1, 1, 4)), 0).astype(np.uint8)
    mlp = None
    if view_mlp:
        first, second, third = (rng.normal(0, 0.3, shape).astype(np.float32) for shape in ((34, 16), (16, 16), (16, 3)))
        biases = np.zeros(16, np.float32), np.zeros(16, np.float32), np.full(3, -2, np.float32)
        mlp = ViewMlp((first, second, third), biases)
    camera = {"ndc": True, "input_width": 400.0, "input_height": 300.0, "input_focal": 350.0} if ndc else {}
    return cube_pack(rgba, BLOCK, NDC_FRAME if ndc else BLENDER_FRAME, features if view_mlp else None, mlp, **camera)


@pytest.fixture(scope="session")
def pack() -> Pack:
    return toy_pack()


@pytest.fixture(scope="session")
def ndc_pack() -> Pack:
    return toy_pack(ndc=True)


@pytest.fixture(scope="session")
def pack_folder(tmp_path_factory: pytest.TempPathFactory, pack: Pack) -> Path:
    return written(tmp_path_factory.mktemp("packs") / "toy", pack)


@pytest.fixture(scope="session")
def known_pack(tmp_path_factory: pytest.TempPathFactory, pack: Pack) -> Pack:
    """The toy, which knows its three photographs of each split."""
    return photographed(pack, tmp_path_factory.mktemp("known") / "toy_scene")


@pytest.fixture(autouse=True)
def nothing_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """No dialog trains something to see how long that takes here, but for tests that ask for it."""
    monkeypatch.setattr(survey, "MEASURES", False)


@pytest.fixture(scope="session")
def demo() -> Path:
    """The bundled pack."""
    return not_none(demo_pack())


@pytest.fixture
def app() -> App:
    return App()


@pytest.fixture
def ctx() -> Iterator[moderngl.Context]:
    """A context of the test's own, in which no OpenGL error may be left."""
    context = create_context()
    yield context
    with context:
        assert context.error == "GL_NO_ERROR"
    context.release()


@pytest.fixture
def offscreen(ctx: moderngl.Context) -> Iterator[Callable[..., OffscreenUi]]:
    """Makes the interface of an app in a framebuffer, with a pack open, where one is given, that is drawn coarsely at rest.
    options: OffscreenUi's.
    """
    made: list[OffscreenUi] = []

    def make(app: App, pack: Pack | None = None, path: Path = Path("toy"), **options) -> OffscreenUi:
        made.append(OffscreenUi(ctx, app, **options))
        if pack is not None:
            app.resolution.rest_scale = 0.25
            app.show(pack, path)
            made[-1].settle()
        return made[-1]

    yield make
    for ui in made:
        ui.release()


@pytest.fixture(scope="session")
def display() -> Iterator[str]:
    """DISPLAY of an Xvfb of our own; skipped where it is not installed, failed in CI."""
    with virtual_screen(installed("Xvfb")) as (name, _):
        yield name
