"""The trainer's test scene, and its rays."""

import pytest

from tests.training.conftest import procedural_path, procedural_scene
from training.dataset import RayDataset, make_dataset
from training.scenes import Scene

__all__ = ["procedural_path", "procedural_scene"]


@pytest.fixture(scope="session")
def scene(procedural_scene: Scene) -> Scene:
    return procedural_scene


@pytest.fixture(scope="session")
def dataset(scene: Scene) -> RayDataset:
    return make_dataset(scene)
