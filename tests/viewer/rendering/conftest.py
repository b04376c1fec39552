"""One offscreen context for all of the renderer's tests, asserted clean around each."""

from collections.abc import Callable, Iterator

import moderngl
import pytest

from scenepack import Pack
from viewer.rendering.offscreen import OffscreenRenderer, create_context


@pytest.fixture(scope="session")
def ctx() -> Iterator[moderngl.Context]:
    """The context; its framebuffer 0 is never used."""
    context = create_context()
    yield context
    context.release()


@pytest.fixture(autouse=True)
def no_opengl_error_is_left(ctx: moderngl.Context) -> Iterator[None]:
    with ctx:  # tests of other folders, run before in this process, have contexts of their own
        assert ctx.error == "GL_NO_ERROR"
        yield
        assert ctx.error == "GL_NO_ERROR"


@pytest.fixture(scope="module")
def offscreen(ctx: moderngl.Context) -> Iterator[Callable[[Pack], OffscreenRenderer]]:
    """Makes OffscreenRenderers in the shared context. One of a pack serves until another pack's is made."""
    last: list[OffscreenRenderer] = []

    def make(pack: Pack) -> OffscreenRenderer:
        if not last or last[0].pack is not pack:
            while last:
                last.pop().release()
            last.append(OffscreenRenderer(pack, ctx=ctx))
        return last[0]

    yield make
    while last:
        last.pop().release()
