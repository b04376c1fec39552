"""Work-arounds for software rasterisers: huge pages, and waiting without Python's lock."""

import platform
import re
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.opengl import GpuClock, is_software
from viewer.rendering.settings import RenderSettings
from viewer.rendering.software_rasteriser import HUGE, huge_pages, move_to_huge_pages

# What a software rasteriser allocates ends in huge pages, and its contents stay


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


# Waiting for the card without Python's lock


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
        draw(), ctx.finish()
        # where moderngl gives the lock away, the module can go
        assert wakings_meanwhile(lambda: (draw(), ctx.finish())) < 5
        assert wakings_meanwhile(lambda: GpuClock(ctx).time(draw)) > 15
