"""macOS and Windows, as far as Linux can stand in for them: OpenGL 3.3 and 4.1 alone, Cmd, contexts without EGL, consoles."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from scenepack import save_pack
from tests.scenepack.helpers import small_pack
from viewer.core.input import holds_command, shown_keys
from viewer.rendering import offscreen

ROOT = Path(__file__).parents[1]
RENDERS = """
import sys
import numpy as np, snerg
from tests.viewer.conftest import toy_pack
from scenepack import save_pack
save_pack(toy_pack(), "toy.zip")
with snerg.load("toy.zip") as scene:
    print(scene._drawn_here().ctx.version_code)
    np.save("picture.npy", scene.render(size=(48, 36)))
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the variables are Mesa's")
def test_pictures_are_the_same_where_there_is_opengl_3_3_or_4_1_alone(tmp_path: Path) -> None:
    pictures = []
    for version, glsl in (("3.3", "330"), ("4.1FC", "410"), ("", "")):
        asked = {"MESA_GL_VERSION_OVERRIDE": version, "MESA_GLSL_VERSION_OVERRIDE": glsl} if version else {}
        environment = {**os.environ, **asked, "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", RENDERS]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        assert not version or done.stdout.strip() == version[:3].replace(".", "") + "0"
        pictures.append(np.load(tmp_path / "picture.npy"))
    assert pictures[0].std() > 20
    for picture in pictures[:2]:
        np.testing.assert_array_equal(picture, pictures[2])


def test_cmd_is_the_key_of_commands_on_macos_but_where_the_system_has_it() -> None:
    assert shown_keys("Ctrl+Shift+Z or Ctrl+Y", "darwin") == "Cmd+Shift+Z or Cmd+Y"
    assert shown_keys("Ctrl+Tab", "darwin") == "Ctrl+Tab" and shown_keys("Ctrl+S", "win32") == "Ctrl+S"
    assert holds_command("S", False, True, "darwin") and not holds_command("S", True, False, "darwin")
    assert holds_command("Tab", True, False, "darwin") and not holds_command("Tab", False, True, "darwin")
    assert holds_command("S", True, False, "win32") and not holds_command("S", False, True, "win32")


@pytest.mark.parametrize(("platform", "options"), [("darwin", {}), ("win32", {}), ("linux", {"backend": "egl"})])
def test_only_linux_is_asked_for_egl(platform: str, options: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    class Context:
        error = "GL_NO_ERROR"

    monkeypatch.setattr(offscreen.sys, "platform", platform)
    monkeypatch.setattr(offscreen.moderngl, "create_context", lambda **given: asked.append(given) or Context())
    offscreen.create_context()
    assert asked == [{"standalone": True, "require": 330, **options}]


@pytest.mark.parametrize("encoding", ["cp437", "cp1252", "ascii"])
def test_a_console_without_unicode_gets_every_line(encoding: str, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT), "PYTHONUTF8": "0"}
    save_pack(small_pack().with_metadata(scene="Straße 棚"), tmp_path / "pack")
    words = [sys.executable, "-m", "snerg", "pack", "info", "pack"]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True)
    assert done.returncode == 0 and b"voxels" in done.stdout, done.stderr
