"""The window and snerg-view, each in a process of its own, on a display of our own."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenepack import load_pack
from tests.messages import without_progress
from tests.scenepack.helpers import written
from tests.viewer.window.running import ROOT, picture_of_view, run_snerg
from viewer.app.application import App
from viewer.commands import view
from viewer.window.window import NoDisplay, Window, require_display


@pytest.mark.parametrize("script", ["live_window.py", pytest.param("live_features.py", marks=pytest.mark.slow)])
def test_the_live_window(display, script):
    """All tests of a script share one window, in a process of its own."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", Path(__file__).with_name(script)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stdout + done.stderr


def test_frames_and_screenshot_at_the_command_line(display, pack_folder, tmp_path):
    picture = picture_of_view(tmp_path, pack_folder, "--mode", "depth", DISPLAY=display)
    assert picture.shape == (500, 800, 3) and picture.std() > 20


def test_without_a_display_an_orbit_is_rendered_and_named(pack_folder, tmp_path):
    done = run_snerg("view", pack_folder, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "no display" in done.stderr.splitlines()[0]
    files = done.stdout.split()
    assert files and all((tmp_path / file).stat().st_size > 1000 for file in files)
    sheet = np.asarray(Image.open(tmp_path / files[0]))
    assert sheet.reshape(-1, 3).std(axis=0).max() > 15


@pytest.fixture(scope="session")
def known_folder(tmp_path_factory, known_pack):
    """Of a pack that knows its photographs."""
    return written(tmp_path_factory.mktemp("known") / "toy", known_pack)


@pytest.mark.slow
def test_a_photograph_is_wiped_at_the_command_line(display, tmp_path, known_folder):
    picture = picture_of_view(tmp_path, known_folder, "--photograph", "test/r_1", "--look", "wipe", DISPLAY=display)
    edge = np.abs(picture - (0x45, 0xD0, 0xBD)).sum(axis=2) < 40
    assert edge[60:490, :400].mean(axis=0).max() > 0.9  # the wipe's edge, from top to bottom


@pytest.mark.slow
def test_another_pack_is_subtracted_at_the_command_line(display, tmp_path, known_folder):
    same = picture_of_view(tmp_path, known_folder, "--compare", known_folder, "--look", "difference", DISPLAY=display)
    assert same[170:490, 10:400].max() < 12  # below the axes


@pytest.mark.slow
def test_a_path_is_exported_to_its_end_at_the_command_line(display, tmp_path, known_folder):
    frames = tmp_path / "frames"
    picture_of_view(tmp_path, known_folder, "--export", frames, "--export-size", "32x24", DISPLAY=display)
    assert len(list(frames.glob("*.png"))) == 240  # a turntable: 8 s of 30 frames


@pytest.mark.slow
def test_a_bad_pack_is_a_dialog_on_a_display(display, tmp_path):
    (tmp_path / "scene_params.json").write_text("{")
    picture = tmp_path / "window.png"
    done = run_snerg("view", tmp_path, "--frames", 5, "--screenshot", picture, "--size", "800x500", DISPLAY=display)
    assert done.returncode == 2
    assert len(without_progress(done.stderr)) == 1 and "scene_params.json" in done.stderr
    pixels = np.asarray(Image.open(picture)).astype(int)
    assert (np.abs(pixels - (0x1A, 0x21, 0x2C)).sum(axis=2) < 6)[150:300, 200:600].mean() > 0.5  # a card, in the middle


@pytest.mark.slow
def test_photographs_are_asked_about_on_a_display_and_told_without_one(display, tmp_path, known_pack):
    scene = known_pack.metadata["provenance"]["scene"]
    pixels = picture_of_view(tmp_path, scene, DISPLAY=display)
    assert (np.abs(pixels - (0x1A, 0x21, 0x2C)).sum(axis=2) < 6)[120:380, 130:670].mean() > 0.4  # a card, in the middle
    done = run_snerg("view", scene)
    assert done.returncode == 2 and "snerg-make" in done.stderr and len(without_progress(done.stderr)) == 1


@pytest.mark.parametrize("words", [["--size", "big"], ["--frames", "3"], ["--photograph", "r_0", "--mode", "sepia"]])
def test_bad_arguments_are_one_line_and_status_2(refused, monkeypatch, pack_folder, words):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    refused(view.main, pack_folder, *words)


@pytest.mark.slow
def test_a_session_is_opened_at_the_command_line_and_a_bad_one_is_one_line(app, display, tmp_path, known_folder):
    app.show(load_pack(known_folder), known_folder)
    app.set(crop=((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)))
    app.interface.page = "crop"
    file = tmp_path / "a.snerg"
    app.sessions.save(app, file)
    whole = picture_of_view(tmp_path, known_folder, "--page", "crop", DISPLAY=display)
    cut = picture_of_view(tmp_path, file, DISPLAY=display)
    assert np.abs(whole - cut)[60:490, 10:400].mean() > 2
    file.write_text("{}")
    done = run_snerg("view", file, "--frames", 2, DISPLAY=display)
    assert done.returncode == 2 and len(without_progress(done.stderr)) == 1 and "is not a session" in done.stderr


def test_a_display_that_does_not_answer_is_no_display(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":4711")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    require_display()
    with pytest.raises(NoDisplay, match="no window can be opened"):
        Window(App())


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Wayland is Linux's")
@pytest.mark.parametrize("words", [(), ("--frames", "1", "--screenshot", "window.png")])
def test_wayland_alone_is_refused_in_one_line_that_names_xwayland(pack_folder, words):
    """Nobody looks for pictures in out/ who started the viewer from a desktop."""
    done = run_snerg("view", pack_folder, *words, WAYLAND_DISPLAY="wayland-0")
    assert done.returncode == 2 and len(without_progress(done.stderr)) == 1 and "XWayland" in done.stderr
