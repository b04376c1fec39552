"""Buffers that shaders read texel by texel (samplerBuffer), which moderngl does not have.

OpenGL's own functions make them a texture. The sampler's unit is written into the shader (layout(binding = ...)), for
moderngl sets no uniform of this type.
"""

from __future__ import annotations

import ctypes
from typing import Any

import moderngl
import numpy as np

GL_TEXTURE0, GL_TEXTURE_BUFFER = 0x84C0, 0x8C2A
FORMATS = {  # by kind: OpenGL's internal format, and bytes of a texel
    "rgba8": (0x8058, 4),
    "r8ui": (0x8232, 1),
    "r16ui": (0x8234, 2),
    "r32i": (0x8235, 4),
    "rg32ui": (0x823C, 8),
}
BINDINGS_IN_SHADERS = "GL_ARB_shading_language_420pack"


def _function(ctx: moderngl.Context, name: str, *arguments: Any) -> Any:
    """OpenGL's function `name`, which returns nothing; None where the driver has none."""
    loader: Any = getattr(ctx.mglo, "_context", None)  # of a window another class than of an offscreen context
    load = getattr(loader, "load_opengl_function", None)
    address = load(name) if load else None
    return ctypes.CFUNCTYPE(None, *arguments)(address) if address else None


def texel_buffers_work(ctx: moderngl.Context) -> bool:
    """Whether the driver has what TexelBuffer needs."""
    return BINDINGS_IN_SHADERS in ctx.extensions and _function(ctx, "glTexBuffer") is not None


class TexelBuffer:
    """`count` texels of one of FORMATS, not initialised, read through texture unit `unit`."""

    def __init__(self, ctx: moderngl.Context, count: int, kind: str, unit: int) -> None:
        format_, _ = FORMATS[kind]
        number, pointer = ctypes.c_uint, ctypes.POINTER(ctypes.c_uint)
        self.unit = unit
        self.buffer = ctx.buffer(reserve=self.size_of(max(count, 1), kind))
        self._activate = _function(ctx, "glActiveTexture", number)
        self._bind = _function(ctx, "glBindTexture", number, number)
        self._delete = _function(ctx, "glDeleteTextures", ctypes.c_int, pointer)
        self._name = number()
        _function(ctx, "glGenTextures", ctypes.c_int, pointer)(1, ctypes.byref(self._name))
        self.use()
        _function(ctx, "glTexBuffer", number, number, number)(GL_TEXTURE_BUFFER, format_, self.buffer.glo)

    @staticmethod
    def size_of(count: int, kind: str) -> int:
        """Bytes of so many texels."""
        return count * FORMATS[kind][1]

    def write(self, data: np.ndarray, offset: int = 0) -> None:
        """Writes C-ordered texels. offset: bytes."""
        self.buffer.write(np.ascontiguousarray(data), offset=offset)

    def use(self) -> None:
        """Binds it to its unit."""
        self._activate(GL_TEXTURE0 + self.unit)
        self._bind(GL_TEXTURE_BUFFER, self._name)

    def release(self) -> None:
        """Frees it."""
        if self._name.value:
            self._delete(1, ctypes.byref(self._name))
            self._name.value = 0
            self.buffer.release()
