"""The trainer's test scene, and its rays."""

import pytest

from training.dataset import RayDataset, make_dataset
from training.scenes import Scene


@pytest.fixture(scope="session")
def scene(procedural_scene: Scene) -> Scene:
    return procedural_scene


@pytest.fixture(scope="session")
def dataset(scene: Scene) -> RayDataset:
    return make_dataset(scene)
