"""Settings of the fast voxel field; defaults are the `cpu` preset's, tuned on two cores.

What a field needs depends on what was photographed. A setting whose default is None is taken from BY_KIND:

    object        cut out by alpha: all else is known to be empty
    surroundings  opaque photographs from many sides: every ray must end somewhere, and much is seen by few photographs
    forward       opaque photographs from one side, in NDC: depth is disparity, which small baselines tell coarsely
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from training.scenes.scene import Kind


@dataclass(frozen=True)
class VoxelConfig:
    """The fast field (training.voxels.method). Resolutions are voxels along the longest side of the scene's box."""

    resolutions: tuple[int, ...] | None = None
    """Voxels along the longest side of the box in each stage, coarse to fine. None: three or four stages, whose last has about
    as many as the photographs have pixels, at most 512."""
    ndc_resolutions: tuple[int, ...] = (120, 240, 480)
    """The same for forward-facing scenes."""
    ndc_depth: float = 4.0
    """Depth of a voxel relative to its width, in forward-facing scenes, where depth is known less precisely."""
    stage_starts: tuple[float, ...] | None = None
    """Start of each stage, as a fraction of all steps. Here and below, None means: chosen by the kind of scene."""
    prunings: tuple[float, ...] | None = None
    """When voxels that no photograph shows are pruned without refining, as fractions of all steps."""
    least_views: int | None = None
    """Voxels that fewer training photographs see are left out from the start."""
    samples_per_step: int | None = None
    """Samples per step, without those in empty space. The number of rays adapts to it. None: from 65,536 for small photographs
    to 262,144 for 512³ voxels."""
    step_voxels: float = 1.0
    """Distance between samples, in voxels; at most 1."""
    last_step_voxels: float = 0.5
    """The same towards the end: a surface within a voxel is told apart by what lies between its corners."""
    finer_samples_from: float = 0.6
    """Fraction of all steps from which samples are last_step_voxels apart, if that is less."""
    close_holes_from: float = 0.9
    """Fraction of all steps after which holes are closed that views between photographs look through; 1 for never."""
    density_rate: float = 0.2
    """Initial learning rate of density (Adam)."""
    colour_rate: float = 0.1
    """Initial learning rate of colours and features (Adam)."""
    head_rate: float = 3e-3
    """Initial learning rate of the view MLP (Adam)."""
    final_rate_factor: float = 0.05
    """All learning rates decay log-linearly to this fraction at the last step."""
    initial_alpha: float = 1e-4
    """Initial opacity of the voxels of the first stage."""
    keep_weight: float | None = None
    """Pruning keeps a voxel if it, or one next to it, contributes at least this fraction to some pixel."""
    density_variation: float | None = None
    """Weight of the total variation of raw density."""
    colour_variation: float | None = None
    """Weight of the total variation of raw colours and features."""
    variation_share: float = 0.02
    """Fraction of the voxels whose total variation is computed in a step."""
    distortion_weight: float | None = None
    """Weight of the distortion loss of mip-NeRF 360, with distances relative to the box; 0 for none."""
    sparsity_factor: float | None = None
    """Factor on the sparsity weight."""
    early_termination: float = 1e-3
    """A ray ends where its transmittance falls below this."""
    random_background: bool = True
    """Train what is cut out before random colours instead of the scene's own. Mist of the background's colour costs nothing
    before it, and is marched through from then on. Opaque photographs always have random colours behind them."""
    view_dependence: bool = True
    """If false, train a diffuse model without a view MLP."""


@dataclass(frozen=True)
class KindSettings:
    """The settings of VoxelConfig that the kind of scene decides where nobody else does; explained there."""

    stage_starts: tuple[float, ...]
    prunings: tuple[float, ...]
    least_views: int = 1
    density_variation: float = 1e-5
    colour_variation: float = 1e-4
    distortion_weight: float = 0.0
    sparsity_factor: float = 1.0
    keep_weight: float = 0.01


BY_KIND: Mapping[Kind, KindSettings] = {
    "object": KindSettings(stage_starts=(0.0, 0.04, 0.2), prunings=(0.015, 0.1, 0.3, 0.6), distortion_weight=0.05),
    # Coarse grids settle where things are before fine ones can hide mist in the gaps between photographs.
    "surroundings": KindSettings(
        stage_starts=(0.0, 0.1, 0.3),
        prunings=(0.05, 0.2, 0.32, 0.45, 0.6),
        least_views=6,
        density_variation=5e-5,
        colour_variation=2e-4,
        distortion_weight=0.01,
        sparsity_factor=2.0,
        keep_weight=0.005,  # a bare wall is mist for long, of many voxels that show little each
    ),
    "forward": KindSettings(
        # What is not settled when the last stage begins becomes millions of fine voxels, each paid for in each step.
        stage_starts=(0.0, 0.1, 0.45),
        prunings=(0.2, 0.35, 0.47, 0.6),
        least_views=3,
        density_variation=3e-3,
        colour_variation=5e-3,
        distortion_weight=0.003,
        sparsity_factor=0.2,
        keep_weight=0.02,
    ),
}


def settings_for(config: VoxelConfig, kind: Kind) -> KindSettings:
    """What the config says, and what suits the kind of scene where it says None."""
    said = {field.name: getattr(config, field.name) for field in dataclasses.fields(KindSettings)}
    return dataclasses.replace(BY_KIND[kind], **{name: value for name, value in said.items() if value is not None})
