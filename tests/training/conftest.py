"""Real scenes for the trainer's tests."""

import os
from pathlib import Path

import pytest


@pytest.fixture
def real_data() -> Path:
    """The folder of real scenes that SNERG_DATA names."""
    folder = os.environ.get("SNERG_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("SNERG_DATA names no folder of real scenes")
    return Path(folder)
