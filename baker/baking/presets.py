"""Named ways to bake: `snerg`, our defaults, and `paper`, what the SNeRG paper writes, setting by setting.

| setting | the paper | `paper` |
| --- | --- | --- |
| voxels along the longest side | 1000, synthetic; 1300, real (section 6) | the same |
| macroblocks | 32³ (section 5.5) | 30³ and their padding, as in the published packs |
| tau_alpha, tau_vis | 0.005, 0.01 (section 5.4) | the same |
| visibility | transmittance from all training views | 1,000,000 rays through pixels of all of them, grown by 2 cells |
| content of a voxel | 16 Gaussian samples, sigma = v / √12; mean colour, features, density | the same |
| voxels within kept macroblocks | all are stored | the same (tau_weight 0) |
| quantisation | 8 bits | the same, rounded |
| fine-tuning | view MLP; Adam, 3e-4, 100 epochs, all training pictures | the same; a step takes as many pixels as a picture has |
| limit of macroblocks | none | none |
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, get_args

if TYPE_CHECKING:
    from training.scenes import Scene

BakePreset = Literal["snerg", "paper"]
FineTune = Literal["auto", "none", "view-mlp", "all", "compact"]  # what is tuned after baking
NAMES: tuple[BakePreset, ...] = get_args(BakePreset)
SYNTHETIC_RESOLUTION, REAL_RESOLUTION = 1000, 1300
UNLIMITED = 2**31 - 1
# Fields of BakeConfig that differ from its defaults. The resolution depends on the scene: see paper_resolution.
CHANGES: Mapping[BakePreset, Mapping[str, Any]] = {
    "snerg": {},
    "paper": {
        "tau_weight": 0.0, "fine_tune": "view-mlp", "fine_tune_epochs": 100, "fine_tune_pixels": 0,
        "supersampling": "paper", "most_macroblocks": UNLIMITED,
    },
}  # fmt: skip


def paper_resolution(scene: Scene) -> int:
    """Voxels along the longest side that the paper takes for a scene: "slightly larger than the size of the training images"."""
    return SYNTHETIC_RESOLUTION if scene.kind == "blender" else REAL_RESOLUTION
