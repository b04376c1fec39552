"""How to bake: what `snerg-bake` asks for. No JAX here, so that --help is quick.

Presets: `snerg`, our defaults, and `paper`, what the SNeRG paper writes (docs/paper.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, SupportsIndex

from console import UserError
from console.command_line import require_in_range
from scenepack.constants import MAX_BLOCK_INDEX
from training.scenes.presets import voxels_for

if TYPE_CHECKING:
    from training.run import Run
    from training.scenes.scene import Box

BakePreset = Literal["snerg", "paper"]
Quality = Literal["draft", "compact", "full"]

BLOCK_SIZE = 30  # data voxels; 32 with padding, aligned with the blocks of image codecs (section 5.4)
SYNTHETIC_RESOLUTION, REAL_RESOLUTION = 1000, 1300  # of the paper
LARGEST_SEED = 2**32 - 1
MOST_MACROBLOCKS = 6000  # 1.6 GB of textures
UNLIMITED = 2**31 - 1


@dataclass(frozen=True)
class BakeConfig:
    resolution: int | None = None  # voxels along the longest side of the content's box; None: see resolution_of
    preset: BakePreset = "snerg"  # by whose method; see above
    # draft: nothing is tuned; full: tuned, in 8 bits; compact: tuned in coarser steps, for 30 % fewer bytes
    quality: Quality = "full"
    seed: int = 0  # of the Gaussian samples within voxels and of tuning
    # Where more would be kept, the grid is made coarser. None: MOST_MACROBLOCKS; in the preset paper, no limit.
    most_macroblocks: int | None = None
    keeps_hidden: bool = False  # macroblocks that no training camera sees: panel (d) of the paper's figure 4
    aabb: Box | None = None  # box to bake, training frame, instead of that around the content; not for NDC scenes

    @property
    def block_limit(self) -> int:
        if self.most_macroblocks is not None:
            return self.most_macroblocks
        return UNLIMITED if self.preset == "paper" else MOST_MACROBLOCKS

    def resolution_of(self, run: Run) -> int:
        """Voxels along the longest side; in the paper's preset "slightly larger than the size of the training images"."""
        scene = run.scene
        if self.resolution is not None:
            return self.resolution
        if self.preset == "paper":
            return SYNTHETIC_RESOLUTION if scene.kind == "blender" else REAL_RESOLUTION
        pixels = max(max(photo.camera.width, photo.camera.height) for photo in scene.splits["train"])
        return voxels_for(pixels, run.dataset.kind)

    def check(self) -> None:
        """UserError where a number makes no sense: for commands to ask before hours of work, not after."""
        if not isinstance(self.resolution, SupportsIndex | None):
            raise UserError("is no whole number", where="--resolution", found=self.resolution)
        require_in_range("--resolution", self.resolution, BLOCK_SIZE, MAX_BLOCK_INDEX * BLOCK_SIZE)
        require_in_range("--seed", self.seed, 0, LARGEST_SEED)
        require_in_range("--most-macroblocks", self.most_macroblocks, 1, UNLIMITED)
