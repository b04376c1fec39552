"""Photographs that the tests of making a scene share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.procedural import write_procedural_scene


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_procedural_scene(tmp_path_factory.mktemp("photographs") / "still", size=24, views=3, subpixels=1)
