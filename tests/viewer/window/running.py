"""snerg-view as a person runs it: a process with a window on a display, under real mouse and keyboard events."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Self

import numpy as np
from PIL import Image

from tests.viewer.conftest import installed
from tests.viewer.waiting import not_none, until

SNERG = [sys.executable, "-m", "snerg"]
ROOT = Path(__file__).parents[3]
PATIENCE_S = 90.0


def without_display() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}


def run_snerg(*words: object, cwd: Path = ROOT, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs a command to its end, without a display but for what `environment` says."""
    own, command = without_display() | environment, [*SNERG, *map(str, words)]
    return subprocess.run(command, env=own, cwd=cwd, capture_output=True, text=True, timeout=180)


def picture_of_view(folder: Path, *words: object, **environment: Any) -> np.ndarray:
    """The window after a few frames of snerg-view, int [500, 800, 3]. folder: for the file."""
    picture = folder / "window.png"
    done = run_snerg("view", *words, "--frames", 5, "--screenshot", picture, "--size", "800x500", **environment)
    assert done.returncode == 0, done.stderr
    return np.asarray(Image.open(picture)).astype(int)


class RunningViewer:
    """A viewer on `display`, its settings below `home`. command: another program than snerg-view that opens one."""

    def __init__(self, display: str, home: Path, *words: object, command: list[str] | None = None, **environment: str):
        self.tool = installed("xdotool")
        self.home, self.file = home, home / "snerg" / "viewer.json"
        home.mkdir(parents=True, exist_ok=True)
        own = {"DISPLAY": display, "XDG_CONFIG_HOME": str(home), "XDG_STATE_HOME": str(home / "state")}
        self.environment = without_display() | own | environment
        self.process = subprocess.Popen(
            [*(command or [*SNERG, "view"]), *map(str, words)],
            env=self.environment,
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
        )

    @property
    def saved(self) -> dict[str, Any]:
        return json.loads(self.file.read_text()) if self.file.exists() else {}

    def xdotool(self, *words: object) -> str:
        command = [self.tool, *(str(word) for word in words)]
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=60)
        return done.stdout

    @property
    def window(self) -> str:
        """Its X window, once it is there to be seen."""

        def found() -> str:
            assert self.process.poll() is None, self.errors()
            return self.xdotool("search", "--onlyvisible", "--pid", self.process.pid)

        return until(found).split()[0]

    def errors(self) -> str:
        """What is left of its stderr, once it has ended."""
        return not_none(self.process.stderr).read()

    def signal(self, number: int) -> int:
        """Sends a signal; the exit status."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(PATIENCE_S)
        not_none(self.process.stderr).close()
