"""The commands draw the renderer's own test packs, under the same watch for OpenGL errors."""

import pytest

from scenepack import Pack, save_pack
from tests.viewer.rendering.conftest import ctx, no_opengl_error_is_left

__all__ = ["ctx", "no_opengl_error_is_left"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, shapes: Pack) -> str:
    path = tmp_path_factory.mktemp("packs") / "shapes"
    save_pack(shapes, path)
    return str(path)


@pytest.fixture(autouse=True)
def our_context_again(ctx):
    """The commands make contexts of their own; the room's is current again behind each test."""
    yield
    ctx.__enter__()
