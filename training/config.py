"""Settings of a training run: one frozen dataclass, one documented field a line. The run stores it as config.json.

TrainConfig holds what every method shares; each method's own numbers are nested under its name. PRESETS
names whole configurations; the command line overrides single fields of one (`--nerf.width 128`).
"""

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from console import UserError
from console.streams import one_line
from training.multires.config import MultiresConfig
from training.scenes.presets import PresetName


@dataclass(frozen=True)
class NerfConfig:
    """The paper's deferred NeRF (sections 4 and 6). Defaults are the paper's own numbers."""

    depth: int = 8
    """Hidden layers of the MLP."""
    width: int = 512
    """Channels per hidden layer."""
    skip_after: int = 4
    """The encoded point is concatenated again after this layer (counted from 0)."""
    coarse_samples: int = 192
    """Stratified samples per ray for the coarse MLP. The sparsity loss uses these samples."""
    fine_samples: int = 384
    """Samples per ray drawn from the coarse weights. The fine MLP is evaluated at both sets."""
    last_interval: float | None = None
    """Length of the last interval of a ray, in units of t. None: endless, so that any density there is opaque, as in NeRF; in
    forward-facing scenes what is left up to the far plane, where the baked grid ends, too."""
    density_noise: float = 0.0
    """Standard deviation of the noise on raw density during training. The sparsity loss is without it. The published code
    uses 1.0 for photographs; the paper names none."""
    first_rate: float = 2e-3
    """Adam's learning rate at the start, before the warm-up factor."""
    last_rate: float = 2e-5
    """Learning rate at the last step. In between it decays log-linearly."""
    warmup_steps: int = 2500
    """Number of warm-up steps; 0 for none."""
    warmup_factor: float = 0.1
    """Factor on the learning rate at step 0."""
    clip_value: float = 0.01
    """Clip each gradient entry to this absolute value, before the norm; 0 for no clipping."""
    clip_norm: float = 0.01
    """Clip the norm of the whole gradient to this value, after the entries; 0 for no clipping."""
    view: Literal["deferred", "tiny", "nerf", "none"] = "deferred"
    """View dependence: the view MLP once per ray (deferred), the same MLP at every sample (tiny), JAXNeRF's layer of 128
    channels at every sample (nerf), or no view dependence (none). Only deferred and none can be baked."""
    matmul: Literal["auto", "float32", "bfloat16"] = "auto"
    """Type of the products in the hidden layers; sums are always float32. auto: float32 on CPUs, bfloat16 elsewhere."""
    gradient_rays: int = 0
    """Rays per device whose gradient is computed at once, to save memory; 0 for the whole batch. Samples stay the same."""
    render_rays: int = 1024
    """Rays that are rendered at once."""
    query_points: int = 65536
    """Points that are evaluated at once when baking."""


EngineName = Literal["auto", "jax", "fused"]


@dataclass(frozen=True)
class TrainConfig:
    """A training run."""

    method: Literal["nerf", "multires"] = "nerf"
    """The model: the paper's MLP (nerf), or features of several resolutions with one small decoder (multires)."""
    engine: EngineName = "auto"
    """What computes the steps of method multires: JAX, or the fused loops for processors (Numba). auto: fused where JAX has no
    accelerator. A run keeps the engine that it began with."""
    steps: int = 250_000
    """Total number of training steps. The learning-rate schedule ends here."""
    batch_size: int | None = None
    """Rays per step of method nerf. None: as in the paper, 8,192 for synthetic scenes (Blender) and 16,384 for photographs.
    Method multires draws as many as fill its samples."""
    seed: int = 0
    """Random seed. The same seed repeats the same run."""
    sparsity_weight: float = 1e-4
    """Weight of the sparsity loss (lambda_s, section 4.3 of the paper); 0 for none."""
    sparsity_scale: float = 0.5
    """Scale c of the sparsity loss."""
    sparsity_over_samples: Literal["paper", "release"] = "paper"
    """How the sparsity loss of method nerf weighs against the colours. paper: sums over samples and over channels. release: means
    of both, as in the published code; with the paper's 192 samples, 64 times less."""
    exposure: Literal["auto", "on", "off"] = "auto"
    """Fit exposure and white balance of each photograph, so that the scene has their average look (method multires). auto: for
    what cameras took, where exposures differ; never for rendered scenes (Blender)."""
    minutes: float = 0.0
    """Stop after this many minutes, with a checkpoint; 0 for no limit. The learning rates reach their last values by then."""
    log_every: int = 100
    """Steps between lines of metrics.jsonl."""
    validate_every: int = 5000
    """Steps between validations; 0 for a single one at the end."""
    validate_views: int = 1
    """Number of held-out photographs that a validation measures. It saves a picture of the middle one."""
    checkpoint_every: int = 5000
    """Steps between checkpoints."""
    nerf: NerfConfig = field(default_factory=NerfConfig)
    """Settings of method nerf."""
    multires: MultiresConfig = field(default_factory=MultiresConfig)
    """Settings of method multires."""


PAPER = TrainConfig(nerf=NerfConfig(gradient_rays=1024))
SYNTHETIC_BATCH, REAL_BATCH = 8192, 16_384  # rays per step (section 6)


def ablation(view: Literal["deferred", "tiny", "nerf", "none"], sparsity_weight: float = 1e-4) -> TrainConfig:
    """`paper` with one thing changed (tables 1 and 2, appendix "Baselines")."""
    return replace(PAPER, sparsity_weight=sparsity_weight, nerf=replace(PAPER.nerf, view=view))


HALF_AS_WIDE = NerfConfig(width=256, coarse_samples=64, fine_samples=128)
SMALL = TrainConfig(batch_size=1024, validate_every=2500, checkpoint_every=2500, nerf=HALF_AS_WIDE)
TINY_NERF = NerfConfig(
    depth=4, width=32, coarse_samples=16, fine_samples=16, warmup_steps=30, first_rate=1e-2, last_rate=1e-3
)
TINY = TrainConfig(steps=300, batch_size=256, log_every=25, validate_every=0, checkpoint_every=100, nerf=TINY_NERF)
# The distortion loss and the occupancy grid keep space empty here; the paper's sparsity weight costs 0.4 dB then.
QUICK = TrainConfig(method="multires", steps=6000, sparsity_weight=2e-6, validate_every=2000, checkpoint_every=2000)

PRESETS: Mapping[PresetName, TrainConfig] = {
    "quick": QUICK,
    "normal": replace(QUICK, steps=12_000),
    "full": replace(QUICK, steps=36_000, validate_every=4000, checkpoint_every=4000),
    "paper": PAPER,
    "small": SMALL,
    "tiny": TINY,
    # the paper's tables; the sparsity loss is its own, and its baselines, which nothing bakes, do without
    "jaxnerf": replace(ablation("nerf", 0.0), nerf=replace(HALF_AS_WIDE, view="nerf", gradient_rays=4096)),
    "jaxnerf-plus": ablation("nerf", 0.0),
    "tinyview": ablation("tiny", 0.0),
    "deferred": PAPER,
    "diffuse": ablation("none"),
    "no-sparsity": ablation("deferred", 0.0),
}


# --- checks of values from a command line or a config.json ---------------------------------------------------------------

LARGEST_WHOLE = 2**32 - 1  # seeds are 32 bits, and so are the counts that a GPU takes
ABOVE_ZERO = {
    "batch_size", "log_every", "checkpoint_every", "depth", "width", "coarse_samples", "fine_samples", "render_rays",
    "query_points", "samples_per_step", "resolutions", "occupancy", "steps_across", "sparsity_scale", "first_rate", "last_rate",
}  # fmt: skip


def from_json(cls: type, values: Mapping[str, Any], where: str) -> Any:
    """The inverse of dataclasses.asdict, with defaults. where: the file. UserError for unknown keys and values without sense."""
    if not isinstance(values, Mapping):
        raise UserError("settings are no object", where=where, expected="{…}", found=type(values).__name__)
    hints = typing.get_type_hints(cls)
    if unknown := sorted(set(values) - set(hints)):
        remedy = "the run was made by another version of snerg"
        raise UserError("unknown settings: " + ", ".join(unknown), where=where, remedy=remedy)
    made = {}
    for name, value in values.items():
        if dataclasses.is_dataclass(hints[name]):
            made[name] = from_json(hints[name], value, f"{where} {name}")
        else:
            made[name] = tuple(value) if isinstance(value, list) else value
    config = cls(**made)
    require_valid(config, where)
    return config


def require_valid(config: Any, where: str | None = None, prefix: str = "") -> None:
    """UserError, naming the setting, where a value of a dataclass, or of one within it, has another type, is negative, not
    finite, or zero where it must not be. where: the file; None for options of the command line."""
    hints = typing.get_type_hints(type(config))
    for setting in dataclasses.fields(config):
        value, hint, name = getattr(config, setting.name), hints[setting.name], prefix + setting.name
        if dataclasses.is_dataclass(value):
            require_valid(value, where, f"{name}.")
            continue
        if expected := _expected_instead(value, hint, 1 if setting.name in ABOVE_ZERO else 0):
            what = "makes no sense" if where is None else f"{name} makes no sense"
            option = "--" + name.replace("_", "-")
            raise UserError(what, where=where or option, expected=expected, found=one_line(repr(value), 40))


def _expected_instead(value: Any, hint: Any, least: int) -> str | None:
    """What is expected in place of `value`; None where it will do. Unions are of one type and None."""
    origin, choices = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Literal:
        return None if value in choices and isinstance(value, str) else f"one of {', '.join(choices)}"
    if origin in (types.UnionType, typing.Union):
        return None if value is None else _expected_instead(value, choices[0], least)
    if origin is tuple:
        if not isinstance(value, tuple):
            return "a list"
        return next((text for item in value if (text := _expected_instead(item, choices[0], least))), None)
    if hint is int:
        fits = type(value) is int and least <= value <= LARGEST_WHOLE
        return None if fits else f"a whole number from {least} to {LARGEST_WHOLE}"
    if hint is float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        fits = number and math.isfinite(value) and value >= 0 and (value > 0 or not least)
        return None if fits else "a number above 0" if least else "a number, not below 0"
    return None if isinstance(value, hint) else hint.__name__
