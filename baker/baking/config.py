"""How to bake: what `snerg-bake` asks for, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from baker.baking.culling import TAU_ALPHA, TAU_VIS
from baker.baking.presets import CHANGES, BakePreset, FineTune
from baker.baking.supersample import Supersampling
from baker.tuning.fine_tune import EPOCHS, FINE_TUNE_PIXELS
from baker.tuning.pruning import TAU_WEIGHT
from console import UserError
from scenepack.constants import MAX_BLOCK_INDEX
from training.scenes.scene import Box

BLOCK_SIZE = 30  # data voxels; 32 with padding, aligned with the blocks of image codecs (section 5.5)
MOST_THIN = 3.0  # dB
LARGEST_SEED = 2**32 - 1
MOST_MACROBLOCKS = 6000  # 1.6 GB of textures, and 6 GB while it is baked; lego at 1000³ has 3,445 before it is pruned


@dataclass(frozen=True)
class BakeConfig:
    """How to bake."""

    resolution: int = 512
    """Voxels along the longest side of the content's box."""
    tau_alpha: float = TAU_ALPHA
    """Macroblocks whose largest opacity is below this are dropped."""
    tau_vis: float = TAU_VIS
    """Macroblocks that no training camera sees with at least this transmittance are dropped."""
    tau_weight: float = TAU_WEIGHT
    """Voxels that would make up less than this of any pixel of any training photograph are emptied, or less where the photographs
    lose MOST_LOST by it; 0 leaves all (the paper)."""
    fine_tune: FineTune = "auto"
    """What is fine-tuned: nothing, the view MLP (the paper's), or after it the stored voxels and the view MLP together (all);
    compact: as all, and what is stored ends in COMPACT steps; auto: as compact where tuning helps and makes up for them,
    elsewhere as all."""
    fine_tune_epochs: int = EPOCHS
    """Passes over the training pixels that refine the view MLP; 0 for none."""
    fine_tune_pixels: int = FINE_TUNE_PIXELS
    """Training pixels that refine the view MLP, an even random share; 0 for all (the paper)."""
    supersampling: Supersampling = "grain"
    """How the content of a voxel is averaged; see baker.baking.supersample."""
    thin: float = 0.0
    """dB of training rays that are given up for a faster, smaller scene, at the end; before, more, which tuning regains."""
    seed: int = 0
    """Seed of the Gaussian samples within voxels and of fine-tuning."""
    most_macroblocks: int = MOST_MACROBLOCKS
    """Where more would be kept, the grid is made coarser."""
    aabb: Box | None = None
    """The box that is baked, training frame, in place of the one around the content; not for NDC scenes."""

    def check(self) -> None:
        """UserError where a number makes no sense: for commands to ask before hours of work, not after."""
        most = MAX_BLOCK_INDEX * BLOCK_SIZE
        ranges = {"resolution": (BLOCK_SIZE, most), "tau_alpha": (0, 1), "tau_vis": (0, 1), "tau_weight": (0, 1),
                  "fine_tune_epochs": (0, 1_000_000), "fine_tune_pixels": (0, 2**31 - 1),
                  "thin": (0, MOST_THIN), "seed": (0, LARGEST_SEED), "most_macroblocks": (1, 2**31 - 1)}  # fmt: skip
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                what = "too coarse" if name == "resolution" and value < low else "is out of range"
                raise UserError(
                    what, where=f"--{name.replace('_', '-')}", expected=f"{low} to {high}", found=str(value)[:40]
                )


def preset_config(preset: BakePreset, resolution: int, **changes: Any) -> BakeConfig:
    """The settings of a preset at a resolution, some of them changed."""
    return BakeConfig(resolution, **{**CHANGES[preset], **changes})
