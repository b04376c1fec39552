"""Programs write the uniforms that they have, as GLSL reads them, and work out nothing that they have not."""

from __future__ import annotations

import moderngl
import numpy as np

from viewer.rendering.opengl import Drawing, free_framebuffer, unbind_framebuffers
from viewer.rendering.shader_source import ShaderText

VERTEX = """#version 330 core
in vec2 corner;
uniform vec2 shift;
void main() { gl_Position = vec4(corner + shift, 0.0, 1.0); }
"""
FRAGMENT = """#version 330 core
uniform mat3 turn;
uniform float share;
uniform float vanishes;
out vec4 colour;
void main() { colour = vec4(turn * vec3(share, 0.0, 0.0), 1.0); }
"""
LEFT_HALF = np.array([[-1, -1], [0, -1], [-1, 1], [-1, 1], [0, -1], [0, 1]], np.float32)


def test_what_is_written_is_drawn_and_what_vanished_is_not_worked_out(ctx: moderngl.Context) -> None:
    buffer = ctx.buffer(LEFT_HALF.tobytes())
    drawing = Drawing(ctx, ShaderText(VERTEX, ()), ShaderText(FRAGMENT, ()), [(buffer, "2f", "corner")])
    target = ctx.simple_framebuffer((4, 2), components=4, dtype="f4")
    target.use()
    ctx.enable_only(moderngl.NOTHING)
    asked = []
    matrix = np.array([[0.25, 7, 7], [0.5, 7, 7], [0.75, 7, 7]])  # its first column is seen
    for shift in (0.0, 1.0):
        target.clear()
        drawing.write(
            {"turn": matrix, "shift": (shift, 0.0), "share": lambda: asked.append("share") or 0.5,
             "vanishes": lambda: asked.append("vanishes"), "of another program": 3.0}
        )  # fmt: skip
        drawing.draw()
        picture = np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(2, 4, 4)
        filled = slice(0, 2) if shift == 0 else slice(2, 4)
        expected = np.zeros((2, 4, 4), np.float32)
        expected[:, filled] = (0.125, 0.25, 0.375, 1.0)
        np.testing.assert_allclose(picture, expected)
    assert asked == ["share", "share"]
    drawing.release()
    buffer.release()
    unbind_framebuffers(ctx)
    free_framebuffer(target)
