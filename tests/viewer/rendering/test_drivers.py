"""Drivers: work-arounds for software rasterisers, the message where OpenGL is too old, and numbers in shaders."""

import platform
import re
import sys
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.viewer.window.running import run_snerg
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.opengl import DRIVER_CHOICES, OVERRIDE, GpuClock, is_software, opengl_refusal
from viewer.rendering.settings import RenderSettings
from viewer.rendering.shader_source import glsl_float
from viewer.rendering.software_rasteriser import HUGE, huge_pages, move_to_huge_pages


def test_new_memory_is_moved_and_keeps_its_contents() -> None:
    if not Path("/proc/self/smaps_rollup").exists():
        pytest.skip("not Linux")
    if "[never]" in Path("/sys/kernel/mm/transparent_hugepage/enabled").read_text():
        pytest.skip("this kernel gives no huge pages")
    import mmap

    before, huge = huge_pages(), huge_bytes()
    memory = mmap.mmap(-1, 16 * HUGE, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    memory.madvise(mmap.MADV_NOHUGEPAGE)  # as if the kernel had not had any at first
    values = np.frombuffer(memory, np.uint32)
    values[:] = np.arange(len(values))
    steps = sum(1 for _ in move_to_huge_pages(huge_pages() - before))
    assert steps >= 1 and np.array_equal(values, np.arange(len(values)))
    if tuple(map(int, platform.release().split(".")[:2])) < (6, 1):
        pytest.skip("this kernel moves memory when it pleases")
    assert huge_bytes() > huge


def huge_bytes() -> int:
    found = re.search(r"AnonHugePages: +(\d+) kB", Path("/proc/self/smaps_rollup").read_text())
    return 1024 * int(found[1]) if found else 0


def wakings_meanwhile(wait: Callable[[], object]) -> int:
    """How often another thread wakes up while `wait` runs: it needs Python's lock for that."""
    wakings, ended = [], threading.Event()

    def wake() -> None:
        while not ended.wait(0.001):
            wakings.append(1)

    thread = threading.Thread(target=wake)
    thread.start()
    before = len(wakings)
    wait()
    during = len(wakings) - before
    ended.set()
    thread.join()
    return during


@pytest.mark.slow
def test_other_threads_run_while_a_picture_is_drawn(ctx, shapes):
    if not is_software(str(ctx.info["GL_RENDERER"])):
        pytest.skip("a card draws it in no time")
    camera, settings = ViewCamera.orbit(shapes, 35, size=(1600, 1200)), RenderSettings(marcher="brute")
    with OffscreenRenderer(shapes, "brute", ctx) as renderer:
        target = renderer.framebuffer(camera.width, camera.height)
        draw = partial(renderer.renderer.render, target, camera, settings)
        draw()
        ctx.finish()
        # where moderngl gives the lock away, the module can go
        assert wakings_meanwhile(lambda: (draw(), ctx.finish())) < 5
        assert wakings_meanwhile(lambda: GpuClock(ctx).time(draw)) > 15


OLD = "OpenGL 2.1 Mesa 20.0, drawn by Mesa Intel 965GM"


@pytest.fixture
def default_driver(monkeypatch) -> None:
    """No variable chooses the driver."""
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
def test_no_opengl_or_an_old_one_is_told_with_a_remedy(
    version, complaint, platform, words, monkeypatch, default_driver
):
    monkeypatch.setattr(sys, "platform", platform)
    line = str(opengl_refusal(version, complaint))
    assert all(word in line for word in [*words, "OpenGL 3.3 or later"]), line
    assert "\n" not in line


@pytest.mark.parametrize("name", DRIVER_CHOICES)
def test_a_variable_that_chooses_the_driver_is_named_with_its_value(name, monkeypatch, default_driver) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv(name, "1")
    line = str(opengl_refusal("", "GLX: Failed to create context", window=True))
    assert f"{name}=1 is set" in line and f"unset {name}" in line and "install a graphics driver" in line


@pytest.mark.parametrize("command", ["view", "render"])
def test_no_driver_is_told_with_what_to_install(display, pack_folder, tmp_path, command) -> None:
    nowhere: dict[str, Any] = {"LIBGL_DRIVERS_PATH": str(tmp_path), "GALLIUM_DRIVER": "none", "DISPLAY": display}
    more = [] if command == "view" else ["--out", tmp_path / "a.png"]
    done = run_snerg(command, pack_folder, *more, **nowhere)
    if done.returncode == 0:
        pytest.skip("this Mesa has its drivers built in")
    line = done.stderr.splitlines()[-1]
    assert done.returncode == 2 and "install a graphics driver" in line and "libgl1-mesa-dri" in line


def test_numbers_survive_the_way_into_a_shader_and_nothing_else_does() -> None:
    for value in (0.0, -1.5, 1e-30, 3.4e38, 1 / 3, np.float32(0.1), 255, True):
        text = glsl_float(value)  # type: ignore[arg-type]  (NumPy's scalars are numbers, too)
        assert np.float32(text) == np.float32(value) and any(mark in text for mark in ".e")
    for value in (float("nan"), float("inf"), "1.0); discard; (", "0; }"):
        with pytest.raises(ValueError):
            glsl_float(value)  # type: ignore[arg-type]
