"""The window and snerg-view, each in a process of its own, on a display of our own."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from viewer.commands.view import parse_size

LIVE = Path(__file__).with_name("live_window.py")


def test_the_live_window(display):
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(LIVE)]
    env = {**os.environ, "DISPLAY": display}
    done = subprocess.run(command, env=env, cwd=LIVE.parents[2], capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stdout + done.stderr


def run_view(*words: object, display: str | None = None, cwd=None) -> subprocess.CompletedProcess[str]:
    env = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    if display:
        env["DISPLAY"] = display
    command = [sys.executable, "-m", "viewer.commands.view", *(str(word) for word in words)]
    return subprocess.run(command, env=env, cwd=cwd, capture_output=True, text=True, timeout=120)


def test_frames_and_screenshot_at_the_command_line(display, pack_folder, tmp_path):
    picture = tmp_path / "window.png"
    done = run_view(
        pack_folder, "--frames", 5, "--screenshot", picture, "--size", "800x500", "--mode", "depth", display=display
    )
    assert done.returncode == 0, done.stderr
    assert Image.open(picture).size == (800, 500)
    assert np.asarray(Image.open(picture)).std() > 20


def test_without_a_display_an_orbit_is_rendered_and_named(pack_folder, tmp_path):
    done = run_view(pack_folder, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "no display" in done.stderr.splitlines()[0]
    files = done.stdout.split()
    assert files and all((tmp_path / file).stat().st_size > 1000 for file in files)
    sheet = np.asarray(Image.open(tmp_path / files[0]))
    assert sheet.reshape(-1, 3).std(axis=0).max() > 15


@pytest.mark.parametrize("on_display", [True, False])
def test_a_bad_pack_is_one_line_and_status_2(request, tmp_path, on_display):
    display = request.getfixturevalue("display") if on_display else None
    (tmp_path / "scene_params.json").write_text("{")
    done = run_view(tmp_path, display=display)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1 and "scene_params.json" in done.stderr


@pytest.mark.parametrize("words", [["--size", "big"], ["--frames", "0"], ["--mode", "sepia"]])
def test_bad_arguments_are_one_line_and_status_2(pack_folder, words):
    done = run_view(pack_folder, *words)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1


def test_sizes_are_read():
    assert parse_size("1280x800") == (1280, 800)
