"""Letting framebuffers go: what moderngl leaves to its callers."""

from __future__ import annotations

import moderngl


def unbind_framebuffers(ctx: moderngl.Context) -> None:
    """Binds a framebuffer that outlives ours: moderngl binds the last one again whenever it makes another."""
    if ctx.screen is not None:
        ctx.screen.use()
        return
    if ctx.extra is None:
        ctx.extra = ctx.simple_framebuffer((1, 1))
    ctx.extra.use()


def free_framebuffer(framebuffer: moderngl.Framebuffer) -> None:
    """Frees a framebuffer with all that is attached to it: its own release() keeps that, 8 bytes for each pixel at least."""
    for attached in (*framebuffer.color_attachments, framebuffer.depth_attachment):
        if attached is not None:
            attached.release()
    framebuffer.release()
