"""What the golden pictures show. `python -m tests.viewer.rendering.golden_variants FOLDER` compares them on whatever card is
there, prints JSON, and leaves in FOLDER those that are beyond the tolerance. Needs nothing that only tests need.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from scenepack.pack import Pack
from tests.viewer.rendering.shapes import shapes_pack, surroundings_pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer, create_context
from viewer.rendering.settings import MODES, RenderSettings

GOLDEN = Path(__file__).parents[2] / "golden"
SIZE = (240, 180)
AMPLIFIED = 8

PACKS: dict[str, Callable[[], Pack]] = {
    "shapes": shapes_pack,
    "ndc_shapes": lambda: shapes_pack(ndc=True),
    "surroundings": surroundings_pack,
}
# By the picture's name: which of PACKS, and how it is drawn.
VARIANTS: dict[str, tuple[str, RenderSettings]] = {
    **{mode: ("shapes", RenderSettings(mode=mode, cost_scale=24)) for mode in MODES},
    "paper": ("shapes", RenderSettings(marcher="paper")),
    "view-mlp-per-sample": ("shapes", RenderSettings(view_mlp_per_sample=True)),
    "crop": ("shapes", RenderSettings(crop=((-0.9, -0.7, -1.0), (0.3, 1.0, 0.2)), background=(0.1, 0.1, 0.15))),
    "near-plane": ("shapes", RenderSettings(near=2.6)),
    "ndc-normal": ("ndc_shapes", RenderSettings()),
    "ndc-depth": ("ndc_shapes", RenderSettings(mode="depth")),
    "ndc-paper": ("ndc_shapes", RenderSettings(marcher="paper")),
    "contracted-normal": ("surroundings", RenderSettings()),
    "contracted-normals": ("surroundings", RenderSettings(mode="normals")),
    "contracted-inner": ("surroundings", RenderSettings(surroundings=False)),
}


@dataclass(frozen=True)
class Tolerance:
    """mean: of the differences, of 255. channel, share: so large a share of the channels may differ by more than `channel`."""

    mean: float
    channel: int
    share: float


# Drivers round differently; a golden picture is to catch what an eye would. Cards also filter with weights of 8 bits, and
# a sample whose opacity lies at a threshold falls to the other side.
ON_LLVMPIPE, ELSEWHERE = Tolerance(0.5, 8, 1e-3), Tolerance(1.0, 8, 1e-2)


def camera_for(pack: Pack) -> ViewCamera:
    if pack.ndc:
        return ViewCamera.look_at((0.3, 0.2, 0), (0, 0, 4), fov_degrees=50, size=SIZE, mirrored=True)
    if pack.contraction is not None:
        return ViewCamera.look_at((-3, 1.4, 2.5), (0.7, -0.2, -0.6), fov_degrees=50, size=SIZE)
    return ViewCamera.orbit(pack, 35, 28, 2.9, fov_degrees=42, size=SIZE)


def compared(actual: np.ndarray, expected: np.ndarray, tolerance: Tolerance) -> dict[str, float | bool]:
    """Two pictures uint8 [H, W, 3]: mean and worst difference (of 255), share beyond tolerance.channel, and whether within."""
    difference = np.abs(actual.astype(int) - expected)
    mean, share = float(difference.mean()), float(np.mean(difference > tolerance.channel))
    within = mean <= tolerance.mean and share <= tolerance.share
    return {"mean": mean, "share": share, "worst": int(difference.max()), "within": within}


def leave(folder: Path, name: str, actual: np.ndarray, expected: np.ndarray) -> None:
    """What is needed to see why two pictures differ."""
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(actual).save(folder / f"{name}-actual.png")
    Image.fromarray(expected).save(folder / f"{name}-expected.png")
    amplified = np.clip(AMPLIFIED * np.abs(actual.astype(int) - expected), 0, 255).astype(np.uint8)
    Image.fromarray(amplified).save(folder / f"{name}-difference-x{AMPLIFIED}.png")


def on_this_card(folder: Path) -> dict[str, object]:
    """{"renderer", "tolerance", "pictures": {name: see compared()}}."""
    ctx = create_context()
    renderer = str(ctx.info["GL_RENDERER"])
    tolerance = ON_LLVMPIPE if "llvmpipe" in renderer else ELSEWHERE
    pictures = {}
    packs = {name: make() for name, make in PACKS.items()}
    for name, (pack, settings) in VARIANTS.items():
        with OffscreenRenderer(packs[pack], settings.marcher, ctx) as offscreen:
            actual = offscreen.render(camera_for(packs[pack]), settings)
        expected = np.asarray(Image.open(GOLDEN / f"{name}.png", formats=["PNG"]).convert("RGB"))
        pictures[name] = compared(actual, expected, tolerance)
        if not pictures[name]["within"]:
            leave(folder, name, actual, expected)
    ctx.release()
    return {"renderer": renderer, "tolerance": vars(tolerance), "pictures": pictures}


if __name__ == "__main__":
    print(json.dumps(on_this_card(Path(sys.argv[1]))))
