"""Scenes that the baker's tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.procedural import write_procedural_scene
from training.dataset import RayDataset, make_dataset
from training.scenes import Scene, load_scene


@pytest.fixture(scope="session")
def scene_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural scene, 12 + 2 views of 48 x 48 pixels, in Blender layout."""
    return write_procedural_scene(tmp_path_factory.mktemp("procedural"), size=48, views=12, subpixels=2)


@pytest.fixture(scope="session")
def scene(scene_path: Path) -> Scene:
    return load_scene(scene_path)


@pytest.fixture(scope="session")
def dataset(scene: Scene) -> RayDataset:
    return make_dataset(scene)
