"""What a picture shall show: one frozen dataclass, from a command line or from sliders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Mode = Literal[
    "normal",
    "diffuse",
    "features",
    "view-dependent",
    "alpha",
    "depth",
    "samples",
    "jumps",
    "macroblocks",
    "atlas",
]
Marcher = Literal["exact", "paper", "brute"]
MODES: tuple[str, ...] = get_args(Mode)
MOST_SAMPLES = 16  # along each side of a pixel
MARCHERS: tuple[str, ...] = get_args(Marcher)


@dataclass(frozen=True)
class RenderSettings:
    """How to draw a pack; every field may change from frame to frame, some at the price of compiling a shader."""

    mode: Mode = "normal"
    """the picture, or one of its ingredients (shaders/display.glsl)"""
    marcher: Marcher = "exact"
    """exact, the paper's baseline, or brute: every sample taken, for verification"""
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """colour behind everything, sRGB in [0, 1]"""
    near: float = 0.0
    """nothing closer than this along the optical axis is shown, grid units; the larger of this and the camera's counts"""
    crop: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    """corners (min, max) of a box in the grid frame outside of which nothing is shown"""
    samples: int = 1
    """rays along each side of a pixel, whose mean is shown (viewer.rendering.supersampling)"""
    cost_scale: float = 64.0
    """the count shown brightest in the modes samples and jumps"""
    counts: bool = False
    """what each ray cost, as numbers instead of a colour: samples fetched, jumps, opacity; for float32 framebuffers"""
    view_mlp_per_sample: bool = False
    """ablation (paper, table 1): ask the view MLP at every sample instead of once a pixel"""
