"""What a config means for one dataset: the constants of a compiled step, and the plan of what happens between steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from console import UserError
from training.config import TrainConfig
from training.dataset import RayDataset
from training.exposure import is_fitted
from training.marching.layout import depth_where
from training.voxels.config import KindSettings, settings_for

SETTLING_STEPS = (
    80  # of a stage, at least: before this too little is visible to tell content from air, however short the run
)
SPARSITY_SAMPLES = 192  # the paper's coarse samples a ray: the spacing that lambda_s was set for
NDC_DEPTH = 2.0  # length of NDC space along a ray, from the near plane to infinity
ADAM_BETAS = (0.9, 0.99)
COARSEST, FINEST = 64, (96, 512)  # voxels along the longest side: of the first stage, and bounds of the last
VOXELS_PER_PIXEL = 1.15  # of the photographs' longer side
MOST_FINER = 2.3  # how much finer a stage may be than the one before: a surface's shell grows thicker by as much
SAMPLES, FINE_FOR_SAMPLES = 65_536, 256  # samples a step of grids up to this fine
# Coarse stages last no longer than in a run of so many steps. Left alone, a coarse grid ends as a thin crisp shell that is
# wrong by a coarse voxel, and what pruning took around it does not come back: a lego of 24,000 steps ended 1 dB lower.
COARSE_IN_STEPS_OF = 6000
MOST_RAYS = 8  # times the config's batch size: where few samples have support, rays are drawn up to this many


class Settings(NamedTuple):
    """Numbers that the compiled step treats as constants.

    step_voxels: distance between samples, in voxels; at the start, then a state's own.
    shift, reference: density is softplus(raw + shift) / reference. last_depth: early termination, see march.
    sparsity_spacing: length between the samples that sparsity_weight was set for. distortion_spread: length that counts as 1.
    """

    step_voxels: float
    shift: float
    reference: float
    background: tuple[float, float, float]
    random_background: bool
    sparsity_weight: float
    sparsity_scale: float
    sparsity_spacing: float
    rates: tuple[float, float, float]
    final_rate_factor: float
    variation: tuple[float, float]
    variation_share: float
    distortion_weight: float
    distortion_spread: float
    last_depth: int


@dataclass(frozen=True)
class Plan:
    """What happens between steps.

    box float64 [2, 3] that holds the content; shape [3] of a voxel, in widths. schedule: step -> resolution of the grid from
    then on; a step that keeps the resolution only prunes. samples: of a step. most_rays: of a step. always_hit: every ray
    ends at something, as in photographs that nothing was cut out of. gains: of the photographs are fitted (training.exposure).
    """

    box: np.ndarray
    shape: np.ndarray
    resolutions: tuple[int, ...]
    schedule: Mapping[int, int]
    least_views: int
    keep_weight: float
    samples: int
    most_rays: int
    always_hit: bool
    gains: bool = False

    @property
    def extent(self) -> float:
        """The longest side of the box."""
        return (self.box[1] - self.box[0]).max()


def plan_of(config: TrainConfig, dataset: RayDataset) -> Plan:
    """The plan of a run."""
    voxels, by_kind = config.voxels, settings_for(config.voxels, dataset.kind)
    resolutions = voxels.ndc_resolutions if dataset.ndc else voxels.resolutions or _resolutions_for(dataset)
    return Plan(
        box=np.asarray(dataset.aabb, np.float64),
        shape=np.array([1.0, 1.0, voxels.ndc_depth if dataset.ndc else 1.0]),
        resolutions=resolutions,
        schedule=schedule(by_kind, config.steps, resolutions),
        least_views=min(by_kind.least_views, dataset.views),
        keep_weight=by_kind.keep_weight,
        samples=voxels.samples_per_step or samples_for(resolutions[-1]),
        most_rays=MOST_RAYS * config.batch_size,
        always_hit=dataset.kind != "object",
        gains=is_fitted(config.exposure, rendered=dataset.facts.rendered),
    )


def _resolutions_for(dataset: RayDataset) -> tuple[int, ...]:
    """Three or four stages: from a grid that a hundred steps settle to one about as fine as the photographs."""
    width = np.asarray(dataset.width, np.int64)
    height = np.diff(np.asarray(dataset.first, np.int64), append=dataset.count) // width
    finest = finest_for(max(width.max(), height.max()))
    refinements = max(int(np.ceil(np.log(finest / COARSEST) / np.log(MOST_FINER))), 2)
    return (*(round(COARSEST * (finest / COARSEST) ** (i / refinements)) for i in range(refinements)), finest)


def finest_for(pixels: int) -> int:
    """Voxels along the longest side of the last stage, for photographs of so many pixels along their longer side."""
    return int(np.clip(VOXELS_PER_PIXEL * pixels, *FINEST)) // 32 * 32


def samples_for(finest: int) -> int:
    """Samples of a step. Fine grids need larger steps: what a step costs whatever its samples grows with the voxels."""
    return int(SAMPLES * np.clip((finest / FINE_FOR_SAMPLES) ** 2, 1, 4))


def schedule(by_kind: KindSettings, steps: int, resolutions: tuple[int, ...]) -> dict[int, int]:
    """step -> resolution of the grid from then on; a step that keeps the resolution only prunes.

    Where there is one resolution more than starts, the second of these is split in two, and the finest stage waits longer.
    Longer runs spend what they have more on the finest stage.
    """
    starts = by_kind.stage_starts
    split = len(resolutions) == len(starts) + 1 > 2
    if len(resolutions) != len(starts) and not split:
        raise UserError(
            "not one resolution for each stage",
            where="--voxels.resolutions",
            expected=f"{len(starts)} or {len(starts) + 1}" if len(starts) > 1 else f"{len(starts)}",
            found=f"{len(resolutions)}",
            remedy="give --voxels.stage-starts as many, too",
        )
    if split:
        starts = (0.0, 0.5 * starts[1], 1.5 * starts[1], *(start + 0.05 for start in starts[2:]))
    coarse = min(steps, COARSE_IN_STEPS_OF)
    begins = [max(round(start * coarse), stage * SETTLING_STEPS) for stage, start in enumerate(starts)]
    prunings = (max(round(share * steps), SETTLING_STEPS) for share in by_kind.prunings)
    stages = {step: sum(begin <= step for begin in begins) - 1 for step in sorted({*begins, *prunings})}
    return {step: resolutions[stage] for step, stage in stages.items()}


def settings_of(config: TrainConfig, dataset: RayDataset, plan: Plan) -> Settings:
    """The constants of a run's steps."""
    voxels, by_kind = config.voxels, settings_for(config.voxels, dataset.kind)
    coarse, fine = plan.extent / plan.resolutions[0], plan.extent / plan.resolutions[-1]
    optical_depth = -np.log1p(-voxels.initial_alpha) * fine / coarse
    return Settings(
        step_voxels=voxels.step_voxels,
        shift=float(np.log(np.expm1(optical_depth))),
        reference=float(fine),
        background=dataset.background,
        random_background=voxels.random_background or dataset.kind != "object" or dataset.facts.cut_out,
        sparsity_weight=config.sparsity_weight * by_kind.sparsity_factor,
        sparsity_scale=config.sparsity_scale,
        sparsity_spacing=float(_ray_length(dataset) / SPARSITY_SAMPLES),
        rates=(voxels.density_rate, voxels.colour_rate, voxels.head_rate),
        final_rate_factor=voxels.final_rate_factor,
        variation=(by_kind.density_variation, by_kind.colour_variation),
        variation_share=voxels.variation_share,
        distortion_weight=by_kind.distortion_weight,
        distortion_spread=float(plan.extent),
        last_depth=depth_where(voxels.early_termination),
    )


def _ray_length(dataset: RayDataset) -> float:
    """Over which the paper would spread its coarse samples of a ray."""
    if dataset.facts.disparity:  # even in 1/t: as far apart as at distance 1 (the cameras', by the readers)
        return 1.0 / dataset.near
    return NDC_DEPTH if dataset.ndc else dataset.far - dataset.near
