"""What a config means for one dataset."""

from typing import NamedTuple

import numpy as np

from console import UserError
from scenepack.constants import NDC_NEAR, VIEW_FREQUENCIES
from training.config import TrainConfig
from training.dataset import RayDataset
from training.multires.config import (
    CONTRACTED_SAMPLES_ACROSS,
    SAMPLES_ACROSS,
    KindSettings,
    MultiresConfig,
    settings_for,
)
from training.scenes.scene import Kind

ADAM_BETAS, ADAM_EPSILON = (0.9, 0.99), 1e-15
COARSEST, FINEST = 16, 512  # resolution of the first level, and of the last at most
FINEST_CONTRACTED = 2048
MOST_CELLS_SAMPLED = 1024  # samples lie as if there were no finer levels
CONTRACTED_FINER = 4  # contracted space has the inner cube in half of its side, and what is looked at in half of that
# Of a step. Fewer, larger steps of as many samples learn less (docs/notebook.md).
SAMPLES, MOST_SAMPLES = 32_768, 131_072
LARGEST_RAW = 12.0  # of density, before its exponential
DECAY_LEFT = 0.05  # of feature_decay at the last step
SPARSITY_SAMPLES = 192  # the paper's coarse samples a ray: the spacing that lambda_s was set for
PARALLAX = 0.6  # pixels between front and back of a cell of NDC; tried on fern alone, at three sizes (docs/notebook.md)
DEEPEST, SHALLOWEST = 4.0, 1.0  # depth of a cell of NDC relative to its width
SAMPLED_BY_DEPTH = 2.0  # below this depth, samples lie farther apart in cells, so that rays do not take more of them
NDC_DEPTH = 2.0  # length of NDC space along a ray, from the near plane to infinity
FEWEST_RAYS, MOST_RAYS, RAYS_TOGETHER = 256, 131_072, 64  # of a step; a multiple of the last


class Settings(NamedTuple):
    """What a config means for one dataset. Hashable: programs are compiled for it."""

    own: MultiresConfig
    by_kind: KindSettings  # those of `own`, as the kind of scene decides where it says None
    resolution: int  # cells of the occupancy grid along the cube
    resolutions: tuple[int, ...]  # of the levels
    ndc_depth: float  # see MultiresConfig; 1 where rays are not warped
    joins: tuple[float, ...]  # share of the run after which each level joins
    samples: int  # of a step
    steps_across: tuple[int, ...]  # see MultiresConfig
    steps_from: tuple[float, ...]
    least_views: int
    gains: bool  # of the photographs are fitted (training.exposure)
    background: tuple[float, float, float]  # the scene's
    random_background: bool
    sparsity: float  # weight of the loss summed over lengths of rays in world units
    sparsity_scale: float
    near: float  # world units from the camera to where a ray begins
    # World units from the camera from which gradients are whole (0: all are): nearer they shrink with the square of the distance
    # (Philip and Deschaintre 2023), as the space between a photograph's rays does.
    whole_from: float

    @property
    def smoothness(self) -> tuple[float, float]:
        """Weights of density, and of colours and features."""
        return self.by_kind.density_smoothness, self.by_kind.colour_smoothness

    def rates_at(self, updates: int, progress: float) -> tuple[float, float, float]:
        """Adam's rates of table, decoder and view MLP with warm-up, decay and bias correction, after so many updates."""
        (beta1, beta2), count, own = ADAM_BETAS, updates + 1, self.own
        warm = min(1.0, count / max(own.warmup_steps, 1))
        scale = warm * self.by_kind.final_rate_factor**progress * np.sqrt(1 - beta2**count) / (1 - beta1**count)
        return float(own.table_rate * scale), float(own.decoder_rate * scale), float(own.view_rate * scale)

    def decay_left(self, progress: float) -> float:
        """Factor on feature_decay: log-linear from 1 to DECAY_LEFT."""
        return DECAY_LEFT**progress

    def step_cells(self, progress: float) -> float:
        """Distance between samples, in cells of the occupancy grid."""
        return self.resolution / self.steps_across[sum(progress >= start for start in self.steps_from)]

    def rays(self, samples_per_ray: float) -> int:
        """Rays that fill a step."""
        rays = int(np.clip(self.samples / max(samples_per_ray, 1.0), FEWEST_RAYS, MOST_RAYS))
        return rays // RAYS_TOGETHER * RAYS_TOGETHER


def settings_of(config: TrainConfig, dataset: RayDataset) -> Settings:
    """The settings of a run. UserError where some do not fit together."""
    own, by_kind = config.multires, settings_for(config.multires, dataset.kind)
    contracted = dataset.facts.contraction is not None
    resolutions = own.resolutions or resolutions_for(longest_side(dataset), contracted)
    depth = (own.ndc_depth or ndc_depth(dataset, resolutions[-1])) if dataset.ndc else 1.0
    cells = min(resolutions[-1], MOST_CELLS_SAMPLED) * (min(depth / SAMPLED_BY_DEPTH, 1.0) if dataset.ndc else 1.0)
    starts, across = zip(*(CONTRACTED_SAMPLES_ACROSS if contracted else SAMPLES_ACROSS), strict=True)
    steps_across = own.steps_across or tuple(max(int(n * cells), own.occupancy // 2) for n in across)
    steps_from = starts[1:] if own.steps_from is None else own.steps_from
    _require_sensible(own, resolutions, steps_across, steps_from)
    return Settings(
        own=own,
        by_kind=by_kind,
        resolution=own.occupancy,
        resolutions=resolutions,
        ndc_depth=depth,
        joins=(0.0, *(by_kind.finest_from * (2 * n > resolutions[-1]) for n in resolutions[1:])),
        samples=own.samples_per_step or samples_for(longest_side(dataset), dataset.kind),
        steps_across=steps_across,
        steps_from=steps_from,
        least_views=max(min(by_kind.least_views, dataset.views // 4), 1),
        gains=config.exposure == "on" or (config.exposure == "auto" and not dataset.facts.rendered),  # cameras meter
        background=dataset.background,
        random_background=own.random_background or dataset.kind != "object" or dataset.facts.cut_out,
        sparsity=config.sparsity_weight * by_kind.sparsity_factor * SPARSITY_SAMPLES / _ray_length(dataset),
        sparsity_scale=config.sparsity_scale,
        near=dataset.facts.near,
        whole_from=dataset.facts.contraction or 0.0,
    )


def _require_sensible(
    own: MultiresConfig, resolutions: tuple[int, ...], steps_across: tuple[int, ...], steps_from: tuple[float, ...]
) -> None:  # fmt: skip
    """UserError where settings do not fit together."""
    across, parts, occupancy, finest = list(steps_across), len(steps_from) + 1, own.occupancy, max(resolutions)
    for option, fits, expected, found in (
        ("occupancy", occupancy % 8 == 0 and 8 <= occupancy <= 512, "a multiple of 8, at most 512", occupancy),
        ("view-octaves", (own.view_octaves or 1) <= VIEW_FREQUENCIES, f"at most {VIEW_FREQUENCIES}", own.view_octaves),
        ("ndc-depth", own.ndc_depth is None or 0.1 <= own.ndc_depth <= 100, "0.1 to 100", own.ndc_depth),
        ("resolutions", min(resolutions) >= 4 and finest <= FINEST_CONTRACTED, "4 to 2048", list(resolutions)),
        ("steps-across", len(across) == parts, f"one more than --multires.steps-from, {parts}", across),
        ("steps-across", min(across) >= occupancy // 2, f"at least half of --multires.occupancy, {occupancy}", across),
    ):
        if not fits:
            raise UserError("makes no sense", where=f"--multires.{option}", expected=expected, found=found)


def ndc_depth(dataset: RayDataset, finest: int) -> float:
    """Depth relative to width of a cell of NDC, of a level with `finest` cells: from the mean of all cameras to one at their root
    mean square distance from it, the parallax between front and back of the cell is PARALLAX."""
    places = np.asarray(dataset.world_T_camera)[:, :2, 3]
    spread = np.sqrt(np.square(places - places.mean(0)).sum(1).mean())
    focal = np.median(np.asarray(dataset.intrinsics)[:, 0])
    deep = 2 * NDC_NEAR * PARALLAX / max(focal * spread, 1e-6)  # parallax: focal · spread · dz / (2 NDC_NEAR)
    wide = np.ptp(dataset.aabb[:, :2], axis=0).max() / finest
    return float(np.clip(deep / wide, SHALLOWEST, DEEPEST))


def longest_side(dataset: RayDataset) -> int:
    """Pixels along the longer side of the largest photograph."""
    width = np.asarray(dataset.width, np.int64)
    height = np.diff(np.asarray(dataset.first, np.int64), append=dataset.count) // width * dataset.facts.row_step
    return int(max(width.max(), height.max()))


def resolutions_for(pixels: int, contracted: bool = False) -> tuple[int, ...]:
    """Powers of two from COARSEST to about the pixels along the longer side of a photograph, and three quarters of the finest."""
    pixels, most = (pixels * CONTRACTED_FINER, FINEST_CONTRACTED) if contracted else (pixels, FINEST)
    finest = int(np.clip(1 << round(np.log2(pixels * 1.25)), 64, most))
    coarser = tuple(COARSEST << i for i in range(int(np.log2(finest / COARSEST))))
    return *coarser, finest * 3 // 4, finest


def samples_for(pixels: int, kind: Kind) -> int:
    """Samples of a step: more pixels need more steps and larger ones. Unbounded scenes gain more by steps; forward-facing ones,
    of few photographs, may be learnt by heart where each pixel is met often (docs/notebook.md)."""
    finer = {"unbounded": pixels / 256, "forward": (pixels / 512) ** 2}.get(kind, (pixels / 256) ** 2)
    return int(np.clip(SAMPLES * finer, SAMPLES, MOST_SAMPLES))


def _ray_length(dataset: RayDataset) -> float:
    """Over which the paper would spread its coarse samples of a ray, in world units."""
    facts = dataset.facts
    if facts.contraction is not None:
        return 4.0 * facts.contraction
    if facts.disparity:  # even in 1/t: as far apart as at distance 1 (the cameras', by the readers)
        return 1.0 / facts.near
    return NDC_DEPTH if dataset.ndc else facts.far - facts.near
