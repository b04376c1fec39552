"""Work-arounds for software rasterisers: huge pages, and waiting without Python's lock."""

import platform
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from viewer.rendering.opengl import GpuClock, free_framebuffer, is_software, unbind_framebuffers
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

SLOW = """
#version 330 core
uniform int turns;
out vec4 colour;
void main() {
    float x = gl_FragCoord.x;
    for (int i = 0; i < turns; ++i) x = fract(sin(x) * 43758.5453);
    colour = vec4(x, 0.25, 0.5, 1.0);
}
"""
ACROSS = "#version 330 core\nvoid main() { gl_Position = vec4(vec2(gl_VertexID % 2, gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0); }"


@pytest.fixture
def slow(ctx):
    """Draws a picture that takes a tenth of a second or more in software, however many cores there are."""
    program = ctx.program(vertex_shader=ACROSS, fragment_shader=SLOW)
    triangle, target = ctx.vertex_array(program, []), ctx.simple_framebuffer((256, 256))
    turns, begun = 1000, time.perf_counter()

    def draw() -> None:
        target.use()
        triangle.render(vertices=3)

    while time.perf_counter() - begun < 0.1 and turns < 1 << 24:
        turns *= 2
        program["turns"], begun = turns, time.perf_counter()
        draw()
        ctx.finish()
    yield draw
    unbind_framebuffers(ctx)
    free_framebuffer(target)
    for thing in (triangle, program):
        thing.release()


def wakings_meanwhile(wait: Callable[[], object]) -> int:
    """How often another thread wakes up while `wait` runs: it needs Python's lock for that."""
    wakings, ended = 0, threading.Event()

    def wake() -> None:
        nonlocal wakings
        while not ended.is_set():
            time.sleep(0.001)
            wakings += 1

    thread = threading.Thread(target=wake)
    thread.start()
    wakings = 0
    wait()
    during = wakings
    ended.set()
    thread.join()
    return during


@pytest.mark.slow
def test_other_threads_run_while_a_picture_is_drawn(ctx, slow):
    if not is_software(str(ctx.info["GL_RENDERER"])):
        pytest.skip("a card draws it in no time")
    begun = time.perf_counter()
    assert wakings_meanwhile(lambda: (slow(), ctx.finish())) < 5  # if moderngl gives the lock away, the module can go
    assert time.perf_counter() - begun > 0.05
    assert wakings_meanwhile(lambda: GpuClock(ctx).time(slow)) > 15
