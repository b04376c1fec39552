"""The presets by name: what each is for, the size of its photographs and the resolution of its bake.

Their training settings are training.config.PRESETS. There is no JAX here, so that the viewer can offer them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from training.scenes.scene import Kind

# --preset of snerg-make: what a pack can hold; and of snerg-train: the paper's baselines, too
BakeablePreset = Literal["quick", "normal", "full", "paper", "small", "tiny", "deferred", "diffuse", "no-sparsity"]
PresetName = Literal[BakeablePreset, "jaxnerf", "jaxnerf-plus", "tinyview"]


# Those that snerg-make also bakes as the paper does (snerg-bake --preset paper).
BAKED_AS_THE_PAPER: tuple[BakeablePreset, ...] = ("paper", "deferred", "diffuse", "no-sparsity")

# Voxels along the longest side of a pack, for each pixel along the photographs' longer side. An object: the paper's 1000 for
# photographs of 800 × 800 (lego baked at 512 lost 1.6 dB, at 1000 nothing). NDC's box is wider than any photograph's view of it.
# Unbounded scenes have their inner cube in half of a side, and much is nearer to the cameras than its middle.
VOXELS_PER_PIXEL: Mapping[Kind, float] = {"object": 1.25, "surroundings": 1.25, "forward": 1.5, "unbounded": 5.0}
FEWEST_VOXELS, MOST_VOXELS = 512, 1000


def voxels_for(pixels: int, kind: Kind) -> int:
    """Voxels along a pack's longest side, by pixels along the photographs'."""
    return max(FEWEST_VOXELS, min(MOST_VOXELS, round(VOXELS_PER_PIXEL[kind] * pixels)))


def bounded_side(width: int, height: int, *, is_panorama: bool) -> int:
    """The pixels that a preset's longest_side limits: the longer side, or a quarter of a panorama's width."""
    return -(-width // 4) if is_panorama else max(width, height)


@dataclass(frozen=True)
class Preset:
    about: str = ""  # for --help, in brackets behind the name
    title: str = ""  # how the viewer offers it; not at all where untitled
    advice: str = ""
    longest_side: int | None = None  # photographs are shrunk to so many pixels; None takes all there are
    resolution: int | None = None  # voxels along the longest side of snerg-make's bake; None: by the photographs


PRESETS: Mapping[PresetName, Preset] = {
    "quick": Preset("minutes", "Quick", "Minutes on any computer, from photographs shrunk to 256 pixels.", 256),
    "normal": Preset(
        "photographs of 512 pixels", "Normal", "Photographs of up to 512 pixels. Takes longer than Quick.", 512
    ),
    "full": Preset(
        "photographs of 1024 pixels", "Full size",
        "Photographs of up to 1024 pixels, up to 1000³ voxels. Takes the longest.", 1024,
    ),
    "paper": Preset(
        "the paper's own numbers, for GPUs", "As in the paper",
        "The paper's own networks and bake: 250,000 steps, for graphics cards. How long they take has not been measured.",
    ),
    "small": Preset("the paper's method, smaller", resolution=512),
    "tiny": Preset("for tests", resolution=96),
    "deferred": Preset("the same as paper"),
    "diffuse": Preset("without the view MLP"),
    "no-sparsity": Preset("without the sparsity loss"),
    "jaxnerf": Preset("the paper's baseline; cannot be baked"),
    "jaxnerf-plus": Preset("the same, as large as paper; cannot be baked"),
    "tinyview": Preset("a small view MLP at every sample; cannot be baked"),
}  # fmt: skip


def names_with_about(kind: object) -> str:
    """The names of a Literal of presets, for --help: "quick (minutes), normal (…), …"."""
    return ", ".join(f"{name} ({preset.about})" for name, preset in PRESETS.items() if name in get_args(kind))
