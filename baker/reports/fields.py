"""Trained fields as rows of the paper's tables: their names, and the commands that would train those that are missing.

The multi-resolution field shares the deferred head and the Cauchy term of the sparsity loss with the paper's deferred NeRF, and
nothing else: tables never call it that.
"""

import shlex
from dataclasses import replace
from pathlib import Path

from baker.reports.paper_figures import NAMES
from training.config import PRESETS, NerfConfig, TrainConfig
from training.run import Run

LARGE = PRESETS["jaxnerf-plus"].nerf
ROW_OF_VIEW = {"nerf": "jaxnerf-plus", "tiny": "tinyview", "deferred": "deferred", "none": "diffuse"}
SIZES = ("depth", "width", "coarse_samples", "fine_samples")
PAPER_STEPS = PRESETS["paper"].steps
OWN = "field"  # the row of a field that the paper has not
OWN_NAMES = {"nerf": "NeRF", "tiny": "NeRF, tiny view MLP", "deferred": "deferred NeRF", "none": "diffuse NeRF"}


def row_of(config: TrainConfig, large: NerfConfig = LARGE) -> str:
    """The row of the paper's tables that a field is: a key of baker.reports.paper_figures.NAMES; OWN where it is none of them.

    large: how large the fields of all rows but JAXNeRF are; that has half the channels and a third of the samples.
    """
    if config.method != "nerf":
        return OWN
    if _as_large_as(config.nerf, large):
        return ROW_OF_VIEW[config.nerf.view]
    return "jaxnerf" if _as_large_as(config.nerf, _small(large)) and config.nerf.view == "nerf" else OWN


def size_of_rows(config: TrainConfig) -> NerfConfig:
    """How large the fields are that stand beside a run in its tables: as the run where it is a NeRF of another size than the
    paper's, so that a ladder of small fields can be measured."""
    return LARGE if config.method != "nerf" or row_of(config) != OWN else config.nerf


def row_of_run(config: TrainConfig) -> str:
    """The row that a run is in its own tables."""
    return row_of(config, size_of_rows(config))


def _small(large: NerfConfig) -> NerfConfig:
    """JAXNeRF's size beside JAXNeRF+'s."""
    coarse, fine = large.coarse_samples // 3, large.fine_samples // 3
    return replace(large, width=large.width // 2, coarse_samples=coarse, fine_samples=fine)


def label_of(config: TrainConfig, step: int) -> str:
    """The name of a field in a table, and how long it was trained."""
    row, nerf, short = row_of(config), config.nerf, f", {step:,} steps"
    if row != OWN:
        name = NAMES[row]
        short = f", {step:,} of the paper's {PAPER_STEPS:,} steps" if step < PAPER_STEPS else ""
    elif config.method == "multires":
        name = "multi-resolution field"
    else:
        name = f"{OWN_NAMES[nerf.view]} of width {nerf.width}, {nerf.coarse_samples} + {nerf.fine_samples} samples"
    loss = ", no sparsity loss" if config.sparsity_weight == 0 and row in (OWN, "deferred", "diffuse") else ""
    return f"{name}{short}{loss}"


def _as_large_as(nerf: NerfConfig, other: NerfConfig) -> bool:
    return all(getattr(nerf, name) == getattr(other, name) for name in SIZES)


def train_command(run: Run, out: Path, preset: str, option: str) -> str:
    """How to train what a row needs, from the photographs of `run`; and with which option of the report to give it then.

    A multi-resolution field without the sparsity loss is one of the same settings but that; all else are presets of the paper's.
    """
    folder = out / "runs" / preset
    words = ["snerg-train", str(run.scene.path), "--out", str(folder), *_training(run, preset), *_reading(run)]
    return f"{shlex.join(words)}; then add {option} {shlex.quote(str(folder))}"


def _training(run: Run, preset: str) -> list[str]:
    config, large = run.config, size_of_rows(run.config)
    if large != LARGE:
        nerf = _small(large) if preset == "jaxnerf" else large
        sizes = [f"--nerf.{name.replace('_', '-')}={getattr(nerf, name)}" for name in SIZES]
        batch = [] if config.batch_size is None else ["--batch-size", str(config.batch_size)]
        return ["--preset", preset, *sizes, "--steps", str(config.steps), *batch]
    if preset == "no-sparsity" and row_of(config) == OWN:
        # The preset whose field this is, however long it was trained; or the one that is nearest.
        alike = (
            name for name, preset in PRESETS.items()
            if preset.method == config.method and getattr(preset, preset.method) == getattr(config, config.method)
        )  # fmt: skip
        like = next(alike, "normal" if config.method == "multires" else "small")
        return ["--preset", like, "--steps", str(config.steps), "--sparsity-weight", "0"]
    return ["--preset", preset]


def _reading(run: Run) -> list[str]:
    options = run.options
    words = [] if options.downscale == 1 else ["--downscale", str(options.downscale)]
    words += ["--spherify"] * bool(options.spherify) + ["--masks"] * options.masks
    given = {"aabb": options.aabb, "up": options.up}
    return words + [f"--{name}=" + ",".join(f"{c:g}" for c in v) for name, v in given.items() if v is not None]
