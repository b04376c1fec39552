"""What is attached to a framebuffer goes with it."""

import moderngl
import pytest

from tools.fuzz.memory import resident
from viewer.rendering.opengl import free_framebuffer, unbind_framebuffers


def test_freeing_a_framebuffer_frees_what_is_attached_to_it(ctx: moderngl.Context) -> None:
    framebuffer = ctx.simple_framebuffer((8, 6))
    attached = (*framebuffer.color_attachments, framebuffer.depth_attachment)
    unbind_framebuffers(ctx)
    free_framebuffer(framebuffer)
    assert all(isinstance(each.mglo, moderngl.InvalidObject) for each in (*attached, framebuffer))
    assert ctx.error == "GL_NO_ERROR"


def test_a_hundred_framebuffers_leave_no_memory_behind(ctx: moderngl.Context) -> None:
    if "llvmpipe" not in ctx.info["GL_RENDERER"]:
        pytest.skip("only a driver without a card keeps its textures in this process's memory")

    def come_and_go() -> int:
        for _ in range(100):
            framebuffer = ctx.simple_framebuffer((256, 256))
            framebuffer.clear(1, 0, 1)
            unbind_framebuffers(ctx)
            free_framebuffer(framebuffer)
        return resident()

    before = come_and_go()
    assert come_and_go() < before + 20 * 2**20  # left behind, they take 50 MiB
