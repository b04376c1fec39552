"""What is attached to a framebuffer goes with it."""

import moderngl

from viewer.rendering.opengl import free_framebuffer, unbind_framebuffers


def test_freeing_a_framebuffer_frees_what_is_attached_to_it(ctx: moderngl.Context) -> None:
    framebuffer = ctx.simple_framebuffer((8, 6))
    attached = (*framebuffer.color_attachments, framebuffer.depth_attachment)
    unbind_framebuffers(ctx)
    free_framebuffer(framebuffer)
    assert all(isinstance(each.mglo, moderngl.InvalidObject) for each in (*attached, framebuffer))
    assert ctx.error == "GL_NO_ERROR"
