"""Textures that a thread allocates ahead, in a context that shares them with ours."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl
import numpy as np
import pytest

from scenepack import Pack
from tests.viewer.conftest import toy_pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.renderer import Renderer
from viewer.rendering.software_rasteriser import software_draws, texture_preallocation
from viewer.rendering.software_rasteriser.texture_preallocation import preallocate

EGL_OPENGL_API, EGL_NONE = 0x30A2, 0x3038


@pytest.fixture
def shared_context(ctx: moderngl.Context) -> Iterator[object]:
    """A context of EGL that shares with `ctx`, to be entered by a thread."""
    if not software_draws(ctx):
        pytest.skip("no software rasteriser: textures are allocated at once")
    egl = ctypes.CDLL("libEGL.so.1")
    for name in ("eglGetCurrentDisplay", "eglGetCurrentContext", "eglCreateContext"):
        getattr(egl, name).restype = ctypes.c_void_p
    display, ours = (ctypes.c_void_p(ask()) for ask in (egl.eglGetCurrentDisplay, egl.eglGetCurrentContext))
    no_config, no_surface = ctypes.c_void_p(), ctypes.c_void_p()
    attributes = (ctypes.c_int32 * 1)(EGL_NONE)
    second = ctypes.c_void_p(egl.eglCreateContext(display, no_config, ours, attributes))
    assert second

    @contextmanager
    def current() -> Iterator[None]:
        egl.eglBindAPI(EGL_OPENGL_API)
        assert egl.eglMakeCurrent(display, no_surface, no_surface, second)
        yield
        egl.eglMakeCurrent(display, no_surface, no_surface, ctypes.c_void_p())

    yield current
    egl.eglDestroyContext(display, second)


@pytest.fixture
def for_all_packs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(texture_preallocation, "WORTH_A_THREAD", 0)


def picture(ctx: moderngl.Context, renderer: Renderer, pack: Pack) -> np.ndarray:
    target = ctx.simple_framebuffer((64, 48))
    renderer.render(target, ViewCamera.orbit(pack, 30.0, 20.0, 4.0, 40.0, (64, 48)))
    return np.frombuffer(target.read(components=3), np.uint8)


@pytest.mark.parametrize("view_mlp", [False, True])
def test_a_pack_in_a_texture_made_ahead_is_drawn_as_any_other(
    ctx, shared_context, for_all_packs, view_mlp: bool
) -> None:
    pack = toy_pack(view_mlp=view_mlp)
    made = preallocate(ctx, pack, shared_context())
    assert made is not None
    renderer = Renderer(ctx, pack, preallocated=made)
    assert made.taken and renderer.scene("exact").textures["atlas_rgba"] is made._texture
    with_room = picture(ctx, renderer, pack)
    plain = OffscreenRenderer(pack, ctx=ctx)
    assert np.array_equal(with_room, picture(ctx, plain.renderer, pack)) and np.ptp(with_room) > 50
    assert renderer.gpu_bytes() == plain.renderer.gpu_bytes()
    made.release()  # which was taken
    assert np.array_equal(with_room, picture(ctx, renderer, pack))
    renderer.release()
