"""What was mended in a pack from elsewhere is said once, in the window; toasts come and go without drawing on."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenepack import save_pack
from tests.viewer.app.test_application import FakeCanvas, finish_loading
from tests.viewer.waiting import until
from viewer.app.application import App
from viewer.app.commands import run
from viewer.core import theme


@pytest.fixture
def untidy(pack, tmp_path) -> Path:
    """A pack made elsewhere: its features are missing, and a number is wrong."""
    folder = tmp_path / "untidy"
    save_pack(pack, folder)
    for file in folder.glob("feature_*"):
        file.unlink()
    params = json.loads((folder / "scene_params.json").read_text())
    params["atlas_blocks_x"] += 1
    (folder / "scene_params.json").write_text(json.dumps(params))
    return folder


def opened(app: App, path: Path) -> str:
    """The toast once the pack is open."""
    app.messages.toast = ""
    app.open(path)
    finish_loading(app)
    return app.messages.toast


def test_what_was_mended_is_shown_once_and_stays_in_the_log(untidy):
    app = App(canvas=FakeCanvas())
    told = opened(app, untidy)
    assert "atlas_blocks" in told and "feature_000.png is missing" in told and app.messages.toast_level == "warning"
    assert str(untidy) not in told and app.messages.toast_left > 5
    assert opened(app, untidy) == ""
    assert sum("feature_000.png" in line.text for line in app.messages.lines) == 2
    params = json.loads((untidy / "scene_params.json").read_text())
    (untidy / "scene_params.json").write_text(json.dumps({**params, "atlas_blocks_x": 99}))
    again = opened(app, untidy)
    assert "feature_000.png" not in again and again  # only what is new


def test_a_sound_pack_is_opened_without_remarks(pack_folder):
    assert opened(App(canvas=FakeCanvas()), pack_folder) == ""


def test_a_toast_is_drawn_when_it_comes_and_when_it_goes_and_not_in_between(untidy):
    app = App(canvas=FakeCanvas())
    opened(app, untidy)
    for _ in range(10):
        app.tick(0.02)
        app.drew()
    assert app.messages.toast_left > 0 and not app.wants_frame
    app.messages.toast_until = 0.0
    app.tick(0.02)
    assert app.wants_frame


def test_a_long_toast_stays_inside_a_small_window(offscreen, app, untidy):
    ui = offscreen(app, size=(480, 360))
    app.open(untidy)
    until(lambda: app.loading.finished)
    ui.settle()
    assert app.messages.toast_left > 0
    stripe = np.abs(ui.picture().astype(int) - (0xF2, 0xB8, 0x66)).sum(axis=2) < 40
    rows, columns = np.nonzero(stripe)
    assert len(rows) > 60 and columns.min() > 4 and rows.max() < 355 and rows.min() > 50
    assert theme.code_of(theme.WARN) == "#f2b866" and run(app, "panels")


def test_the_real_window_shows_it(display, untidy, tmp_path):
    words = [str(untidy), "--frames", "3", "--screenshot", str(tmp_path / "a.png"), "--size", "900x600"]
    command = [sys.executable, "-m", "viewer.commands.view", *words]
    done = subprocess.run(command, env={**os.environ, "DISPLAY": display}, capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stderr
    picture = np.asarray(Image.open(tmp_path / "a.png")).astype(int)[480:590, :560]
    assert ((np.abs(picture - (0xF2, 0xB8, 0x66)).sum(axis=2) < 40).sum(axis=0) > 25).any()  # the stripe of a warning
