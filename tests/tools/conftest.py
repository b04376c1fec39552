"""Reports draw the renderer's own test packs; profiles train the trainer's test scene."""

from tests.training.conftest import procedural_path, procedural_scene
from tests.viewer.rendering.conftest import ctx, ndc_shapes, shapes

__all__ = ["ctx", "ndc_shapes", "procedural_path", "procedural_scene", "shapes"]
