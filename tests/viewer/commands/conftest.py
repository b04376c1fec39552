"""The commands draw the renderer's own test packs, under the same watch for OpenGL errors."""

from __future__ import annotations

from tests.viewer.rendering.conftest import ctx, ndc_shapes, no_opengl_error_is_left, real_pack, shapes

__all__ = ["ctx", "ndc_shapes", "no_opengl_error_is_left", "real_pack", "shapes"]
