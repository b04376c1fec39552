"""Drawing without a pause: how many frames a second, and how much power the card takes for it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from typing import Any

from viewer.benchmark.frames import PowerMeter
from viewer.rendering.camera import ViewCamera
from viewer.rendering.frame_times import WARM_UP_FRAMES
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings


def sustained(
    renderer: OffscreenRenderer, cameras: Sequence[ViewCamera], settings: RenderSettings, seconds: float
) -> dict[str, Any]:
    """frames, fps, watts and fps_per_watt while `cameras` are drawn over and over for so many seconds. watts: None where
    unknown."""
    framebuffer = renderer.framebuffer(cameras[0].width, cameras[0].height)

    def draw(camera: ViewCamera) -> None:
        renderer.renderer.render(framebuffer, camera, settings)
        renderer.ctx.finish()

    for _ in range(WARM_UP_FRAMES):
        draw(cameras[0])
    frames, began = 0, time.perf_counter()
    with PowerMeter(str(renderer.ctx.info["GL_RENDERER"])) as meter:
        for camera in itertools.cycle(cameras):
            draw(camera)
            frames += 1
            if time.perf_counter() - began >= seconds:
                break
    fps = frames / (time.perf_counter() - began)
    return {
        "frames": frames,
        "fps": fps,
        "watts": meter.watts,
        "fps_per_watt": fps / meter.watts if meter.watts else None,
    }
