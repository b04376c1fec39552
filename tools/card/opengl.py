"""What OpenGL does here: which card it is, and of each pack whether its picture is exact and how long it takes."""

import itertools
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from console.atomic import replacing
from scenepack import Pack, load_pack
from tools.card.parts import Budget, Facts
from viewer.benchmark.frames import Contender, mean_watts, measure, power_readings, sustained
from viewer.benchmark.protocols import flight, protocol_for
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer, create_context
from viewer.rendering.opengl import GpuClock
from viewer.rendering.settings import RenderSettings
from viewer.rendering.software_rasteriser import is_software

# docs/rendering.md, "Marchers"
MOST_DIFFERENCE, MOST_SHARE = 4.0, 0.001  # of 255, and of channels that differ by more than 1 / 255
EXACT_MODES = ("normal", "diffuse", "alpha")
PACKAGES = ("numpy", "moderngl", "glcontext", "jax", "jaxlib", "nvidia-ml-py")
LEAST_IDLE_S = 1.0


@dataclass(frozen=True)
class Sizes:
    """How much is drawn of a pack. size: width, height in pixels. frames: of the camera path, for times. views: for exactness.

    power_s: seconds of drawing without a pause for each marcher, for watts.
    """

    size: tuple[int, int] = (800, 800)
    frames: int = 150
    views: int = 8
    power_s: float = 4.0


def device() -> Facts:
    """The card, its driver, and what it draws in watts while nothing is asked of it."""
    ctx = create_context()
    try:
        info = ctx.info
        facts: dict[str, Any] = {
            "renderer": str(info["GL_RENDERER"]),
            "vendor": str(info["GL_VENDOR"]),
            "opengl": str(info["GL_VERSION"]),
            "largest_3d_texture": int(info["GL_MAX_3D_TEXTURE_SIZE"]),
            "timer": f"wall time, for {reason}" if (reason := GpuClock(ctx).reason) else "GPU timer queries",
        }
    finally:
        ctx.release()
    packages = {}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    facts["software"] = is_software(facts["renderer"])
    with power_readings(facts["renderer"]) as idle:
        time.sleep(0.0 if facts["software"] else LEAST_IDLE_S)
    facts |= {
        "card": card_facts(facts["renderer"]),
        "idle_watts": mean_watts(idle),
        "system": platform.platform(),
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": sys.version.split()[0],
        "packages": packages,
    }
    return facts


def card_facts(renderer: str) -> dict[str, Any]:
    """What NVML says of the card: name, driver, bytes, watts allowed, MHz; {} where it says nothing. renderer: GL_RENDERER."""
    if "nvidia" not in renderer.lower():
        return {}
    try:
        import pynvml  # pyright: ignore[reportMissingImports]

        pynvml.nvmlInit()
        card = pynvml.nvmlDeviceGetHandleByIndex(0)
    except Exception:  # no package, or no driver: each has errors of its own
        return {}
    asked: dict[str, Callable[[], Any]] = {
        "name": lambda: str(pynvml.nvmlDeviceGetName(card)),
        "driver": lambda: str(pynvml.nvmlSystemGetDriverVersion()),
        "bytes": lambda: int(pynvml.nvmlDeviceGetMemoryInfo(card).total),
        "watts_allowed": lambda: pynvml.nvmlDeviceGetEnforcedPowerLimit(card) / 1000.0,
        "mhz": lambda: int(pynvml.nvmlDeviceGetMaxClockInfo(card, pynvml.NVML_CLOCK_GRAPHICS)),
        "memory_mhz": lambda: int(pynvml.nvmlDeviceGetMaxClockInfo(card, pynvml.NVML_CLOCK_MEM)),
    }
    facts = {}
    for name, ask in asked.items():
        with suppress(Exception):  # a card that does not tell this one
            facts[name] = ask()
    return facts


def pack_figures(path: Path, name: str, out: Path, sizes: Sizes, _: Budget) -> Facts:
    """Exactness, frame times, power and a picture of one pack, out/NAME.png."""
    pack = load_pack(path)
    protocol = protocol_for(pack)

    def path_of(frames: int) -> Sequence[ViewCamera]:
        return flight(pack, protocol, frames, size=sizes.size).cameras

    facts: dict[str, Any] = {
        "path": str(path),
        "voxels": list(pack.grid_size),
        "macroblocks": int(pack.occupied.sum()),
        "view_mlp": pack.view_mlp is not None,
        **flight(pack, protocol, 1, size=sizes.size).facts,
    }
    with OffscreenRenderer(pack, allow_half=False) as renderer:
        facts["exactness"] = exactness(renderer, path_of(sizes.views))
        with replacing(out / f"{name}.png") as new:
            Image.fromarray(renderer.render(path_of(sizes.views)[0])).save(new, format="PNG")
        facts["picture"] = f"{name}.png"
        facts["timer"] = timer(renderer, path_of(min(sizes.frames, 30)))
        cameras = path_of(sizes.frames)
        facts["power"] = {
            marcher: sustained(renderer, cameras, RenderSettings(marcher=marcher), sizes.power_s)
            for marcher in ("exact", "paper")
        }
    facts["times"] = times(pack, cameras)
    held = facts["exactness"]["holds"]
    return facts | {"problems": [] if held else ["exact is not the picture of every sample: see exactness"]}


def exactness(renderer: OffscreenRenderer, cameras: Sequence[ViewCamera]) -> Facts:
    """How `exact` differs from taking every sample, over views and modes. worst: of 255. beyond: share of channels that
    differ by more than 1 / 255. holds: whether docs/rendering.md allows it.
    """
    worst, beyond, squares, count = 0.0, 0, 0.0, 0
    modes = EXACT_MODES if renderer.pack.view_mlp is not None else ("normal", "alpha")
    for camera, mode in itertools.product(cameras, modes):
        exact, brute = (
            renderer.render_float(camera, RenderSettings(mode=mode, marcher=marcher))  # type: ignore[arg-type]
            for marcher in ("exact", "brute")
        )
        difference = 255.0 * np.abs(exact.astype(np.float64) - brute)
        worst = max(worst, float(difference.max())) if np.isfinite(difference).all() else float("inf")
        beyond += int((difference > 1.0).sum())
        squares += float(np.square(difference).sum())
        count += difference.size
    error = squares / count / 255.0**2
    return {
        "views": len(cameras),
        "modes": list(modes),
        "worst": worst if np.isfinite(worst) else None,
        "beyond": beyond / count,
        "psnr": -10.0 * float(np.log10(error)) if error > 0 and np.isfinite(error) else None,
        "holds": worst <= MOST_DIFFERENCE and beyond / count <= MOST_SHARE,
    }


def timer(renderer: OffscreenRenderer, cameras: Sequence[ViewCamera]) -> Facts:
    """The same frames by the card's clock and by the wall clock around finish(), medians in milliseconds."""
    clock = GpuClock(renderer.ctx)
    framebuffer = renderer.framebuffer(cameras[0].width, cameras[0].height)
    pairs = [clock.time(lambda c=camera: renderer.renderer.render(framebuffer, c)) for camera in cameras]
    gpu = [ms for ms, _ in pairs if ms is not None]
    return {
        "gpu_ms_p50": float(np.median(gpu)) if gpu else None,
        "wall_ms_p50": float(np.median([wall for _, wall in pairs])),
        "reason": clock.reason,
    }


def times(pack: Pack, cameras: Sequence[ViewCamera]) -> Facts:
    """`exact` and `paper`, frames alternating, as snerg-bench measures them."""
    ways = {"exact": RenderSettings(), "paper": RenderSettings(marcher="paper")}
    measured = measure(cameras, [Contender(name, settings, pack) for name, settings in ways.items()])
    exact, paper = measured.contenders
    return {
        "frames": len(cameras),
        "clock": measured.clock,
        "exact": exact.statistics(),
        "paper": paper.statistics(),
        **paper.ratio_to(exact),
        "psnr": paper.psnr if np.isfinite(paper.psnr) else None,
        "ms_exact": [round(ms, 4) for ms in exact.ms],
        "ms_paper": [round(ms, 4) for ms in paper.ms],
    }
