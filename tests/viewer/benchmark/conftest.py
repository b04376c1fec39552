"""Reports draw the renderer's own test packs."""

from tests.viewer.rendering.conftest import ctx, ndc_shapes, shapes

__all__ = ["ctx", "ndc_shapes", "shapes"]
