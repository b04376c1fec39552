"""Scenes and configurations that the trainer's tests share."""

import os
from pathlib import Path

import pytest

from tools.procedural import write_procedural_scene
from training.scenes import Scene, load_scene


@pytest.fixture(scope="session")
def procedural_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural scene, 12 + 2 views of 48 x 48 pixels, in Blender layout."""
    return write_procedural_scene(tmp_path_factory.mktemp("procedural"), size=48, views=12, subpixels=2)


@pytest.fixture(scope="session")
def procedural_scene(procedural_path: Path) -> Scene:
    return load_scene(procedural_path)


@pytest.fixture
def real_data() -> Path:
    """The folder of real scenes that SNERG_DATA names."""
    folder = os.environ.get("SNERG_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("SNERG_DATA names no folder of real scenes")
    return Path(folder)
