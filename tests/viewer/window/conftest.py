"""The mouse and the keyboard of the display that the live tests' window is on."""

import os
import shutil
import subprocess

import pytest

from tests.viewer.conftest import missing


@pytest.fixture
def xdotool(display):
    """Moves the mouse and presses keys on our display."""
    program = shutil.which("xdotool")
    if program is None:
        missing("xdotool")

    def call(*words: object) -> None:
        command = [str(program), *(str(word) for word in words)]
        subprocess.run(command, check=True, env={**os.environ, "DISPLAY": display}, stdout=subprocess.DEVNULL)

    return call
