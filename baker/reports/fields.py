"""What a trained field is, in the paper's words where it is the paper's, and in ours where it is not.

The multi-resolution field shares the deferred head and the Cauchy term of the sparsity loss with the paper's deferred NeRF, and
nothing else: tables never call it that.
"""

from __future__ import annotations

from baker.reports.paper_figures import NAMES
from training.config import PRESETS, NerfConfig, TrainConfig

LARGE, SMALL = PRESETS["jaxnerf-plus"].nerf, PRESETS["jaxnerf"].nerf
ROW_OF_VIEW = {"nerf": "jaxnerf-plus", "tiny": "tinyview", "deferred": "deferred", "none": "diffuse"}
PAPER_STEPS = PRESETS["paper"].steps
OWN = "field"  # the row of a field that the paper has not


def row_of(config: TrainConfig) -> str:
    """The row of the paper's tables that a field is: a key of baker.reports.paper_figures.NAMES; OWN where it is none of them."""
    if config.method != "nerf":
        return OWN
    if _as_large_as(config.nerf, LARGE):
        return ROW_OF_VIEW[config.nerf.view]
    if _as_large_as(config.nerf, SMALL) and config.nerf.view == "nerf":
        return "jaxnerf"
    return OWN


def label_of(config: TrainConfig, step: int) -> str:
    """The name of a field in a table, and how long it was trained."""
    row = row_of(config)
    if row != OWN:
        name = NAMES[row]
        short = f", {step:,} of the paper's {PAPER_STEPS:,} steps" if step < PAPER_STEPS else ""
    else:
        name = _own_name(config)
        short = f", {step:,} steps"
    loss = ", no sparsity loss" if config.sparsity_weight == 0 and row in (OWN, "deferred", "diffuse") else ""
    return f"{name}{short}{loss}"


def _own_name(config: TrainConfig) -> str:
    if config.method == "multires":
        return "multi-resolution field"
    nerf = config.nerf
    kind = {"nerf": "NeRF", "tiny": "NeRF, tiny view MLP", "deferred": "deferred NeRF", "none": "diffuse NeRF"}[
        nerf.view
    ]
    return f"{kind} of width {nerf.width}, {nerf.coarse_samples} + {nerf.fine_samples} samples"


def _as_large_as(nerf: NerfConfig, other: NerfConfig) -> bool:
    names = ("depth", "width", "coarse_samples", "fine_samples")
    return all(getattr(nerf, name) == getattr(other, name) for name in names)
