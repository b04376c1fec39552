"""What a picture shall show: one frozen dataclass, from a command line or from sliders."""

from dataclasses import dataclass
from typing import Literal, get_args

from scenepack.exports.field import Corners

Mode = Literal[
    "normal", "diffuse", "features", "view-dependent", "alpha", "depth", "normals", "samples", "jumps", "macroblocks", "atlas",
]  # fmt: skip
Marcher = Literal["exact", "paper", "brute"]
MODES: tuple[Mode, ...] = get_args(Mode)
MOST_SAMPLES = 16  # along each side of a pixel
LENS_RAYS = (4, 4096)  # of an aperture, least and most
MARCHERS: tuple[str, ...] = get_args(Marcher)


@dataclass(frozen=True)
class Backdrop:
    """What is seen behind everything instead of the plain background, put there by opacity after all shading."""

    style: Literal["gradient", "checker"]
    first: tuple[float, float, float]  # sRGB in [0, 1], above, or of half of the squares
    second: tuple[float, float, float]  # below, or of the other squares


@dataclass(frozen=True)
class Look:
    """How colours are shown, in linear light; Look() leaves them as they are."""

    exposure: float = 0.0  # stops
    temperature: float = 0.0  # stops of red over blue: above 0 is warmer
    tint: float = 0.0  # stops of red and blue over green: above 0 is magenta
    saturation: float = 1.0  # 0 is grey

    @property
    def gain(self) -> tuple[float, float, float]:
        """Factors of red, green and blue. White balance keeps the luminance of greys."""
        warm, magenta = 2.0 ** (0.5 * self.temperature), 2.0 ** (0.5 * self.tint)
        red, green, blue = warm * magenta, 1.0 / magenta, magenta / warm
        scale = 2.0**self.exposure / (0.2126 * red + 0.7152 * green + 0.0722 * blue)
        return scale * red, scale * green, scale * blue


# least, most
LOOKS = {"exposure": (-4.0, 4.0), "temperature": (-1.0, 1.0), "tint": (-1.0, 1.0), "saturation": (0.0, 2.0)}


@dataclass(frozen=True)
class Aperture:
    """The opening of a lens: what lies away from the plane in focus is blurred (viewer.rendering.supersampling)."""

    diameter: float  # grid units
    focus: float  # from the camera to the plane in focus, along the optical axis, grid units
    rays: int = 64  # through points of the opening, whose mean is shown


@dataclass(frozen=True)
class RenderSettings:
    """How to draw a pack; every field may change from frame to frame, some at the price of compiling a shader."""

    mode: Mode = "normal"  # the picture, or one of its ingredients (shaders/display.glsl)
    marcher: Marcher = "exact"  # exact, the paper's baseline, or brute: every sample taken, for verification
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)  # colour behind everything, sRGB in [0, 1]
    backdrop: Backdrop | None = None  # seen behind everything instead; the view MLP is given `background` all the same
    look: Look | None = None  # of the scene's colours, not of what lies behind it; None where anything is measured
    near: float = 0.0  # nothing closer along the optical axis is shown, grid units; the larger of this and the camera's
    crop: Corners | None = None  # of a box in the grid frame outside of which nothing is shown
    surroundings: bool = True  # whether what lies beyond the inner cube of a contracted pack is shown
    samples: int = 1  # rays along each side of a pixel, whose mean is shown (viewer.rendering.supersampling)
    aperture: Aperture | None = None  # of pictures that have colours or opacity; None: all is sharp
    cost_scale: float = 64.0  # the count shown brightest in the modes samples and jumps
    raw: bool = False  # numbers with opacity, for float32 framebuffers of four components (viewer.rendering.layers)
    view_mlp_per_sample: bool = False  # ablation (paper, table 1): the view MLP at every sample instead of once a pixel
