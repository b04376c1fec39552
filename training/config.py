"""What a training run is told: one frozen dataclass, one documented field a line. The run stores it as config.json.

TrainConfig holds what every method shares; each method's own numbers are nested under its name. PRESETS
names whole configurations; the command line overrides single fields of one (`--nerf.width 128`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from console import UserError
from training.presets import PresetName
from training.voxels.config import VoxelConfig


@dataclass(frozen=True)
class NerfConfig:
    """The paper's deferred NeRF (sections 4 and 6). Defaults are the paper's own numbers."""

    depth: int = 8
    """Hidden layers of the field's MLP."""
    width: int = 512
    """Channels per hidden layer."""
    skip_after: int = 4
    """The encoded point is concatenated again behind this layer (counted from 0)."""
    coarse_samples: int = 192
    """Stratified samples per ray for the coarse field; the sparsity loss is computed at these."""
    fine_samples: int = 384
    """Samples per ray drawn from the coarse weights; the fine field is asked at both sets."""
    last_interval: float = 1e10
    """World units that the last sample of a ray stands for (NeRF: all the rest, so that any density there is opaque)."""
    density_noise: float = 0.0
    """Standard deviation of the noise on raw density while training (the release: 1.0 on real scenes)."""
    first_rate: float = 2e-3
    """Adam's learning rate at the start, before the warm-up factor."""
    last_rate: float = 2e-5
    """Learning rate at the last step; between them it falls log-linearly."""
    warmup_steps: int = 2500
    """Steps of the warm-up; 0 for none."""
    warmup_factor: float = 0.1
    """Factor on the learning rate at step 0."""
    clip_value: float = 0.01
    """Each gradient entry is clipped to this size, before the norm; 0 for no clipping."""
    clip_norm: float = 0.01
    """The whole gradient's norm is clipped to this, after the values; 0 for no clipping."""
    view: Literal["deferred", "tiny", "nerf", "none"] = "deferred"
    """What depends on the viewing direction: the view MLP once a ray (deferred); the same MLP at every sample (tiny);
    JAXNeRF's layer of 128 channels at every sample (nerf); nothing (none). Only deferred and none can be baked."""
    matmul: Literal["auto", "float32", "bfloat16"] = "auto"
    """Type in which the field's hidden layers multiply (sums are float32 always). auto: bfloat16 but on CPUs."""
    gradient_rays: int = 0
    """Rays per device whose gradient is computed at once, to save memory; 0 for the whole batch. Draws no other samples."""
    render_rays: int = 1024
    """Rays per slice when rendering."""
    query_points: int = 65536
    """Points per slice when the field is queried."""


EngineName = Literal["auto", "jax", "fused"]


@dataclass(frozen=True)
class TrainConfig:
    """A training run."""

    method: Literal["nerf", "voxels"] = "nerf"
    """The field: the paper's MLPs, or the fast voxel grid."""
    engine: EngineName = "auto"
    """What computes the steps of the voxel grid: JAX, or the fused loops for processors (Numba). auto: fused where JAX has
    no accelerator. A run keeps the engine it began with."""
    steps: int = 250_000
    """Steps in all; the learning rate's schedule ends here."""
    batch_size: int = 8192
    """Rays per step (the paper: 8,192 for synthetic scenes, 16,384 for real ones)."""
    seed: int = 0
    """Seed of everything random; the same seed repeats the same run."""
    sparsity_weight: float = 1e-4
    """lambda_s, weight of the Cauchy loss on density (section 4.3); 0 for none."""
    sparsity_scale: float = 0.5
    """c of the Cauchy loss."""
    sparsity_over_samples: Literal["sum", "mean"] = "sum"
    """How a ray's samples are reduced: the paper's text sums, the release averages."""
    minutes: float = 0.0
    """Stop (with a checkpoint, resumable) after this much wall time; 0 for no limit."""
    log_every: int = 100
    """Steps between lines of metrics.jsonl."""
    validate_every: int = 5000
    """Steps between validations; 0 for only one at the end."""
    validate_views: int = 1
    """Photographs whose mean PSNR a validation measures, spread over those held out; the middle one is pictured."""
    checkpoint_every: int = 5000
    """Steps between checkpoints."""
    nerf: NerfConfig = field(default_factory=NerfConfig)
    """Settings of method nerf."""
    voxels: VoxelConfig = field(default_factory=VoxelConfig)
    """Settings of method voxels."""


PAPER = TrainConfig(nerf=NerfConfig(gradient_rays=1024))


def ablation(view: Literal["deferred", "tiny", "nerf", "none"], sparsity_weight: float = 1e-4) -> TrainConfig:
    """`paper` with one thing changed (tables 1 and 2, appendix "Baselines")."""
    return dataclasses.replace(
        PAPER, sparsity_weight=sparsity_weight, nerf=dataclasses.replace(PAPER.nerf, view=view)
    )  # fmt: skip


# The sparsity loss is the paper's own; its baselines, which nothing bakes, do without.
JAXNERF_PLUS, TINYVIEW = ablation("nerf", 0.0), ablation("tiny", 0.0)
JAXNERF = dataclasses.replace(
    JAXNERF_PLUS,
    nerf=dataclasses.replace(JAXNERF_PLUS.nerf, width=256, coarse_samples=64, fine_samples=128, gradient_rays=4096),
)
SMALL = TrainConfig(
    batch_size=1024,
    validate_every=2500,
    checkpoint_every=2500,
    nerf=NerfConfig(width=256, coarse_samples=64, fine_samples=128),
)
TINY = TrainConfig(
    steps=300,
    batch_size=256,
    log_every=25,
    validate_every=0,
    checkpoint_every=100,
    nerf=NerfConfig(
        depth=4,
        width=32,
        coarse_samples=16,
        fine_samples=16,
        warmup_steps=30,
        first_rate=1e-2,
        last_rate=1e-3,
    ),
)
# voxels meet content at every step, the paper's coarse samples seldom: a smaller weight says the same
CPU = TrainConfig(
    method="voxels", steps=6000, batch_size=4096, sparsity_weight=2e-5, validate_every=1000, checkpoint_every=1000,
)  # fmt: skip
FAST = TrainConfig(
    method="voxels", steps=20_000, batch_size=65_536, sparsity_weight=2e-5, validate_every=2000, checkpoint_every=2000,
    voxels=VoxelConfig(resolutions=(128, 256, 512), samples_per_step=1 << 20),
)  # fmt: skip

PRESETS: Mapping[PresetName, TrainConfig] = {
    "cpu": CPU,
    "fast": FAST,
    "paper": PAPER,
    "small": SMALL,
    "tiny": TINY,
    # the paper's tables
    "jaxnerf": JAXNERF,
    "jaxnerf-plus": JAXNERF_PLUS,
    "tinyview": TINYVIEW,
    "deferred": PAPER,
    "diffuse": ablation("none"),
    "no-sparsity": ablation("deferred", 0.0),
}


def to_json(config: Any) -> dict[str, Any]:
    """A config as plain dicts, for config.json."""
    return dataclasses.asdict(config)


def from_json(cls: type, values: Mapping[str, Any], where: str) -> Any:
    """The inverse of to_json. Keys that are gone are refused, keys that are new take their defaults."""
    names = {f.name: f for f in dataclasses.fields(cls)}
    if cls is NerfConfig and "view_dependence" in values:  # runs of 0.1.0's first weeks
        values = {**values, "view": "deferred" if values["view_dependence"] else "none"}
        values.pop("view_dependence")
    if cls is VoxelConfig and "horizon" in values:  # runs of 0.1.0, before it was called by the field's word
        values = {**values, "early_termination": values["horizon"]}
        values.pop("horizon")
    if cls is TrainConfig:  # runs of before there was a choice
        values = {"engine": "jax", **values}
    unknown = sorted(set(values) - set(names))
    if unknown:
        raise UserError(
            "unknown settings: " + ", ".join(unknown),
            where=where,
            remedy="the run was made by another version of snerg",
        )
    nested = {"nerf": NerfConfig, "voxels": VoxelConfig}
    made = {}
    for name, value in values.items():
        if cls is TrainConfig and name in nested:
            made[name] = from_json(nested[name], value, f"{where} {name}")
        else:
            made[name] = tuple(value) if isinstance(value, list) else value
    return cls(**made)
