"""An OpenGL that is too old, or none, is message_of with what is there, what is needed and what to do."""

import os
import subprocess
import sys
from typing import Any

import pytest

from tests.viewer.window.running import ROOT, run_view
from viewer.rendering.opengl import DRIVER_CHOICES, OVERRIDE, opengl_refusal

OLD = "OpenGL 2.1 Mesa 20.0, drawn by Mesa Intel 965GM"


@pytest.fixture(autouse=True)
def no_driver_is_chosen(monkeypatch) -> None:
    for name in (OVERRIDE, *DRIVER_CHOICES):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("version", "complaint", "platform", "words"),
    [
        (OLD, "", "linux", ["2.1", "965GM", "update the graphics driver", "LIBGL_ALWAYS_SOFTWARE=1"]),
        ("OpenGL 3.0 Mesa 10.1, drawn by Gallium 0.4 on llvmpipe", "", "linux", ["update Mesa", "apt-get install"]),
        ("", "libEGL.so not loaded", "linux", ["libEGL.so not loaded", "install a graphics driver", "apt-get install"]),
        ("OpenGL 4.5 Mesa, drawn by llvmpipe", "eglMakeCurrent failed", "linux", ["eglMakeCurrent failed"]),
        ("", "GLX: GLX extension not found", "linux", ["this display has no OpenGL", "ssh -X"]),
        ("OpenGL 1.1.0, drawn by GDI Generic", "", "win32", ["1.1.0", "graphics card's maker", "Remote Desktop"]),
        ("OpenGL 2.1 INTEL, drawn by Intel GMA", "", "darwin", ["update macOS"]),
    ],
)
def test_what_is_there_what_is_needed_and_what_to_do(version, complaint, platform, words, monkeypatch) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    line = str(opengl_refusal(version, complaint))
    assert all(word in line for word in [*words, "OpenGL 3.3 or later"]), line
    assert "\n" not in line


@pytest.mark.parametrize("name", DRIVER_CHOICES)
def test_a_variable_that_chooses_the_driver_is_named_with_its_value(name, monkeypatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv(name, "1")
    line = str(opengl_refusal("", "GLX: Failed to create context", window=True))
    assert f"{name}=1 is set" in line and f"unset {name}" in line and "install a graphics driver" in line


@pytest.mark.parametrize("command", ["view", "render"])
def test_no_driver_is_told_with_what_to_install(display, pack_folder, tmp_path, command) -> None:
    nowhere: dict[str, Any] = {"LIBGL_DRIVERS_PATH": str(tmp_path), "GALLIUM_DRIVER": "none"}
    if command == "view":
        done = run_view(pack_folder, DISPLAY=display, **nowhere)
    else:
        words = [sys.executable, "-m", "viewer.commands.render", str(pack_folder), "--out", str(tmp_path / "a.png")]
        done = subprocess.run(words, env=os.environ | nowhere, capture_output=True, text=True, timeout=120, cwd=ROOT)
    if done.returncode == 0:
        pytest.skip("this Mesa has its drivers built in")
    line = done.stderr.splitlines()[-1]
    assert done.returncode == 2 and "install a graphics driver" in line and "libgl1-mesa-dri" in line
