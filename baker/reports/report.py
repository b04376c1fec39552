"""The SNeRG paper's tables of one run (section 7), measured one after another and kept in the report's folder."""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from dataclasses import replace as changed
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from baker.baking.bake import check_bake
from baker.baking.config import BLOCK_SIZE, BakeConfig, BakePreset, Quality, default_resolution
from baker.reports import tables
from baker.reports.fields import OWN, row_of
from baker.reports.figures import FIGURES, draw_figure
from baker.reports.pages import FIGURES_NAME, report_text
from baker.reports.paper_figures import NAMES, whose
from baker.reports.performance import Drawing, performance_table, resolution_table
from baker.reports.plots import draw_report_plots
from baker.reports.real_scenes import real_table
from baker.reports.report_cache import Study
from console import UserError
from console.atomic import write_file
from scenepack.constants import MAX_BLOCK_INDEX
from training.run import Run, load_run, read_description


@dataclass(frozen=True)
class Wanted:
    """What tables show. qualities: of our own bake, in the quality table. resolutions: of the resolution table. preset: of the
    bake in the tables of storage and resolution. quick: only each codec's default quality.
    """

    qualities: Sequence[Quality] = ("compact",)
    resolutions: Sequence[int] = (1000, 750, 500)
    preset: BakePreset = "paper"
    drawing: Drawing = field(default_factory=Drawing)
    quick: bool = False


@dataclass(frozen=True)
class Sources:
    """What a report is about. scene: where the photographs are now; views: score at most this many of `split`, 0 for all.
    resolution: None takes the paper's. overrides: fields of BakeConfig for all packs. against, baselines: folders of runs."""

    run: Path
    out: Path
    scene: Path | None = None
    split: str = "test"
    views: int = 0
    resolution: int | None = None
    overrides: Mapping[str, Any] = field(default_factory=dict)
    against: Path | None = None
    baselines: Sequence[Path] = ()


def write_tables(study: Study, chosen: Sequence[str], wanted: Wanted) -> None:
    """Makes the tables `chosen`, of TABLES, and writes the report anew after each.

    UserError, before anything is baked, where a resolution cannot be.
    """
    _check_resolutions([study.resolution, *wanted.resolutions])
    document = _begun(study)
    makers = {
        "quality": lambda: tables.quality_table(study, wanted.qualities),
        "storage": lambda: tables.storage_table(study, wanted.preset, wanted.quick),
        "performance": lambda: performance_table(study, wanted.drawing),
        "resolution": lambda: resolution_table(study, wanted.preset, wanted.resolutions, wanted.drawing),
        "sparsity": lambda: tables.sparsity_table(study),
        "real": lambda: real_table(study),
    }
    for name in chosen:
        made = makers[name]()
        if name == "quality":
            drawn = {f: draw_figure(study, made["rows"], rows, study.out / f"{f}.png") for f, rows in FIGURES.items()}
            made[FIGURES_NAME] = {f: figure for f, figure in drawn.items() if figure is not None}
        made = json.loads(json.dumps(made))
        if name not in document["made"] or document["tables"].get(name) != made:  # else it was made by an earlier call
            document["made"][name] = provenance()
        document["tables"][name] = made
        _write(study.out, document)  # now: what follows may take an hour
        print(f"{name}: in {study.out / 'report.md'}", flush=True)


def _check_resolutions(sides: Sequence[int]) -> None:
    """UserError, before anything is baked, where a grid can be too coarse or too fine."""
    most = MAX_BLOCK_INDEX * BLOCK_SIZE
    for side in sides:
        if not BLOCK_SIZE <= side <= most:
            raise UserError("cannot be baked", where="--resolution, --resolutions",
                            expected=f"{BLOCK_SIZE} ... {most} voxels", found=side)  # fmt: skip


def open_study(sources: Sources) -> Study:
    """The run, its photographs that count, and the runs beside it. UserError where they do not fit together."""
    run = load_run(sources.run, scene_path=sources.scene)
    check_bake(run, BakeConfig(**sources.overrides))
    if sources.against is not None:
        _require_same_scene(run, sources.against)
        if read_description(sources.against).config.sparsity_weight != 0:
            raise UserError("was trained with the sparsity loss", where=f"--against {sources.against}",
                            expected="a run with --sparsity-weight 0")  # fmt: skip
    split = sources.split
    photographs = run.scene.splits.get(split, ())
    if not photographs:
        raise UserError(
            "no photographs in this split", where="--split", expected=", ".join(run.scene.splits), found=split
        )
    if 0 < sources.views < len(photographs):
        places = np.linspace(0, len(photographs) - 1, sources.views).round().astype(int)
        photographs = tuple(photographs[i] for i in places)
    scored = changed(run.scene, splits={**run.scene.splits, split: photographs})
    resolution = default_resolution("paper", run) if sources.resolution is None else sources.resolution
    baselines = _baselines(run, sources.baselines)
    return Study(run, scored, split, sources.out, resolution, sources.overrides, sources.against, baselines)


def _require_same_scene(run: Run, other: Path) -> None:
    description = read_description(other)
    if description.scene.name != run.description.scene.name or description.options != run.options:
        raise UserError(
            "is a run of another scene, or reads the scene differently", where=other,
            expected=f"{run.description.scene}, {vars(run.options)}", found=f"{description.scene}, {vars(description.options)}",
        )  # fmt: skip


def _baselines(run: Run, folders: Sequence[Path]) -> dict[str, Path]:
    """Folders by the row of the paper that their runs are. UserError where one is none."""
    found: dict[str, Path] = {}
    for folder in folders:
        _require_same_scene(run, folder)
        row = row_of(read_description(folder).config)
        if row == OWN or row in found or row == row_of(run.config):
            raise UserError("is a row that is there already" if row != OWN else "is no row of the paper's tables",
                            where=f"--baselines {folder}", expected=", ".join(NAMES[name] for name in NAMES if name != "snerg"),
                            found=NAMES.get(row, "another field"))  # fmt: skip
        found[row] = folder
    return found


def _begun(study: Study) -> dict[str, Any]:
    """The report so far: what an earlier call left, if it was about the same run and photographs."""
    photographs = study.scene.splits[study.split]
    camera = photographs[0].camera
    about = {
        "run": str(study.run.path.resolve()), "step": study.run.step, "scene": str(study.scene.path),
        "out": str(study.out.resolve()), "name": study.name, "kind": study.kind, "theirs": whose(study.kind, study.name),
        "downscale": study.run.downscale, "split": study.split, "views": len(photographs), "width": camera.width,
        "height": camera.height,
    }  # fmt: skip
    if study.mask is not None:
        about["aabb"] = list(study.overrides["aabb"])
    try:
        kept = json.loads((study.out / "report.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        kept = {}
    same = isinstance(kept, dict) and kept.get("about") == about and isinstance(kept.get("tables"), dict)
    return {"about": about, "tables": kept["tables"] if same else {}, "made": kept.get("made", {}) if same else {}}


def provenance() -> dict[str, str]:
    """What a table was made by: this program's command line, its commit (or version), and the machine."""
    program, *words = sys.argv
    commit = run_program(["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--exclude", "*"])
    cores = f"{os.cpu_count()} x {platform.machine()} cores, JAX on {jax.devices()[0].device_kind}"
    return {
        "command": shlex.join([Path(program).name, *words]), "commit": commit or version("snerg"), "device": cores,
    }  # fmt: skip


def run_program(words: Sequence[str]) -> str:
    """What a program prints; nothing where it is missing or fails."""
    try:
        return subprocess.run(words, capture_output=True, text=True, timeout=30, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def _write(out: Path, document: dict[str, Any]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    draw_report_plots(out, document["tables"])
    write_file(out / "report.json", json.dumps(document, indent=2) + "\n")
    write_file(out / "report.md", report_text(document))
