"""Programs that know which uniforms they have, and the vertices that they draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import moderngl
import numpy as np

from viewer.rendering.shader_source import ShaderText, compile_program


class Program:
    """A vertex and a fragment shader, compiled and linked. linked: as moderngl has it."""

    def __init__(self, ctx: moderngl.Context, vertex: ShaderText, fragment: ShaderText) -> None:
        self.linked = compile_program(ctx, vertex, fragment)
        # Asked for once: a window draws hundreds of frames a second, and each has some twenty values to write.
        members = ((name, self.linked[name]) for name in self.linked)
        self._uniforms = [(name, member) for name, member in members if isinstance(member, moderngl.Uniform)]

    def write(self, values: Mapping[str, Any]) -> None:
        """Numbers, vectors or matrices by the name of their uniform, or functions that work one out, called if it is there.

        Values that the program has no uniform for are passed over: what a variant does not use vanishes when it is linked.
        """
        for name, uniform in self._uniforms:
            if name in values:
                value = values[name]
                value = value() if callable(value) else value
                uniform.write(np.asarray(value, "f4").T.tobytes())  # GLSL's matrices are column-major

    def release(self) -> None:
        self.linked.release()


class Drawing(Program):
    """A program and what it always draws: content, (buffer, format, attribute) each as moderngl has it; none for
    fullscreen.vert."""

    def __init__(
        self,
        ctx: moderngl.Context,
        vertex: ShaderText,
        fragment: ShaderText,
        content: Sequence[tuple[moderngl.Buffer, str, str]] = (),
    ) -> None:
        super().__init__(ctx, vertex, fragment)
        self.vertices = ctx.vertex_array(self.linked, list(content))

    def draw(self, vertices: int = -1) -> None:
        """Draws triangles from the first `vertices`; from all of them unless told."""
        self.vertices.render(moderngl.TRIANGLES, vertices=vertices)

    def release(self) -> None:
        self.vertices.release()
        super().release()
