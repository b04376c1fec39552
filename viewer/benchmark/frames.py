"""What snerg-bench measures: frame times of contenders (viewer.rendering.frame_times), the card's power, and how much
pictures differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scenepack.pack import Pack
from viewer.benchmark.power import PowerMeter
from viewer.rendering.camera import ViewCamera
from viewer.rendering.frame_times import Contender, taking_turns
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

PSNR_FRAMES = 8  # compared between two marchers, spread over the path


@dataclass(frozen=True)
class Measurement:
    """contenders: with their times, in the order given. clock: what measured them. watts: None where unknown.

    psnr: by name, of a contender against the first one, dB over the frames compared; infinite where they are equal.
    grid_size: voxels (x, y, z) of the pack as it was drawn.
    """

    renderer: str
    clock: str
    contenders: list[Contender]
    gpu_bytes: dict[str, int]
    watts: float | None
    psnr: dict[str, float]
    grid_size: tuple[int, int, int]


def measure(
    pack: Pack,
    cameras: list[ViewCamera],
    contenders: list[Contender],
    other_packs: Mapping[str, Pack] | None = None,
    *,
    allow_half: bool = False,
) -> Measurement:
    """Draws every camera with every contender in turn. UserError where there is no OpenGL or the pack does not fit.

    other_packs: by name, packs to be measured beside it, each drawn like the first contender. allow_half: a pack that does
    not fit is measured at half its resolution.
    """
    with taking_turns(pack, contenders, other_packs, allow_half=allow_half) as turns:
        turns.warm_up(cameras[0])
        with PowerMeter(turns.device) as meter:
            turns.time(cameras)
        compared, first = cameras[:: max(1, len(cameras) // PSNR_FRAMES)], contenders[0].settings
        psnr = {c.name: _psnr(turns.offscreen, compared, c.settings, first) for c in contenders[1:]}
        drawn = turns.offscreen.pack.grid_size
        return Measurement(turns.device, turns.clock, turns.contenders, turns.gpu_bytes, meter.watts, psnr, drawn)


def _psnr(
    offscreen: OffscreenRenderer, cameras: list[ViewCamera], settings: RenderSettings, against: RenderSettings
) -> float:
    errors = []
    for camera in cameras:
        difference = offscreen.render_float(camera, settings) - offscreen.render_float(camera, against)
        errors.append(np.mean(np.square(difference, dtype=np.float64)))
    error = float(np.mean(errors))
    return float("inf") if error == 0 else -10.0 * float(np.log10(error))
