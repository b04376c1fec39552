"""Settings of the fast voxel field; defaults are the `cpu` preset's, tuned on two cores."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VoxelConfig:
    """The fast field (training.voxels.method). Resolutions are voxels along the longest side of the scene's box."""

    resolutions: tuple[int, ...] = (64, 128, 256)
    """Grid resolution of each stage, coarse to fine."""
    ndc_resolutions: tuple[int, ...] = (96, 192, 384)
    """The same for forward-facing scenes, whose pictures fill their box from side to side."""
    ndc_depth: float = 3.0
    """Depth of a voxel in widths, in forward-facing scenes; depth there is disparity, which small baselines tell coarsely."""
    stage_starts: tuple[float, ...] = (0.0, 0.04, 0.2)
    """Where each stage begins, as a share of all steps."""
    prunings: tuple[float, ...] = (0.015, 0.1, 0.3, 0.6)
    """Where unseen voxels are dropped without refining, as shares of all steps."""
    samples_per_step: int = 65_536
    """Samples of the field a step, empty space left out; rays are drawn until they fill this list."""
    step_voxels: float = 1.0
    """Distance between samples, in voxels; at most 1."""
    density_rate: float = 0.2
    """Adam's learning rate of raw density, at the start."""
    colour_rate: float = 0.1
    """Adam's learning rate of raw colours and features, at the start."""
    head_rate: float = 3e-3
    """Adam's learning rate of the view MLP, at the start."""
    final_rate_factor: float = 0.05
    """All learning rates fall log-linearly to this share at the last step."""
    initial_alpha: float = 1e-4
    """Opacity of a voxel of the first stage at the start."""
    keep_weight: float = 0.01
    """A voxel is kept where it, or one beside it, contributes at least this share to some pixel."""
    density_variation: float = 1e-5
    """Weight of the total variation of raw density."""
    colour_variation: float = 1e-4
    """Weight of the total variation of raw colours and features."""
    variation_share: float = 0.02
    """Share of voxels whose variation is looked at in a step."""
    distortion_weight: float = 0.0
    """Weight of the distortion loss of mip-NeRF 360, with distances as shares of the box; 0 for none."""
    horizon: float = 1e-3
    """Samples behind which less light than this comes from are left out of a step."""
    view_dependence: bool = True
    """False trains a diffuse model: no view MLP."""
