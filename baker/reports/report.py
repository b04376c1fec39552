"""The SNeRG paper's tables of one run (section 7), measured one after another and kept in the report's folder."""

import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from baker.baking.bake import check_bake
from baker.baking.config import BakeConfig
from baker.reports import tables
from baker.reports.evaluation import photographs_of
from baker.reports.fields import OWN, row_of, row_of_run, size_of_rows
from baker.reports.figures import FIGURES, draw_figure, draw_report_plots
from baker.reports.options import ReportOptions
from baker.reports.pages import FIGURES_NAME, report_text
from baker.reports.paper_figures import NAMES, whose
from baker.reports.report_cache import Study, read_note
from console import UserError, write_json, write_result
from training.run import Run, load_run, read_description


def write_tables(study: Study, chosen: Sequence[str]) -> None:
    """Makes the tables `chosen`, of baker.reports.options.TABLES, and writes the report anew after each.

    UserError, before anything is baked, where a resolution cannot be.
    """
    for side in (study.resolution, *study.options.sides):
        study.config("paper", resolution=side).check()
    document = _begun(study)
    makers = {
        "quality": tables.quality_table, "storage": tables.storage_table, "performance": tables.performance_table,
        "resolution": tables.resolution_table, "sparsity": tables.sparsity_table, "real": tables.real_table,
    }  # fmt: skip
    for name in chosen:
        made = makers[name](study)
        if name == "quality":
            drawn = {f: draw_figure(study, made["rows"], rows, study.out / f"{f}.png") for f, rows in FIGURES.items()}
            made[FIGURES_NAME] = {f: figure for f, figure in drawn.items() if figure is not None}
        made = json.loads(json.dumps(made))
        if name not in document["made"] or document["tables"].get(name) != made:  # else it was made by an earlier call
            document["made"][name] = provenance()
        document["tables"][name] = made
        study.out.mkdir(parents=True, exist_ok=True)  # now: what follows may take an hour
        draw_report_plots(study.out, document["tables"])
        write_json(study.out / "report.json", document)
        write_result(study.out / "report.md", report_text(document))
        print(f"{name}: in {study.out / 'report.md'}", flush=True)


def open_study(path: Path, options: ReportOptions) -> Study:
    """The run, its photographs that count, and the runs beside it. UserError where they do not fit together."""
    run = load_run(path, scene_path=options.scene)
    check_bake(run, BakeConfig(aabb=options.box))
    if options.against is not None:
        _require_same_scene(run, options.against)
        if read_description(options.against).config.sparsity_weight != 0:
            raise UserError("was trained with the sparsity loss", where=f"--against {options.against}",
                            expected="a run with --sparsity-weight 0")  # fmt: skip
    split = options.split
    photographs = photographs_of(run.scene, split)
    if 0 < options.views < len(photographs):
        places = np.linspace(0, len(photographs) - 1, options.views).round().astype(int)
        photographs = tuple(photographs[i] for i in places)
    scored = replace(run.scene, splits={**run.scene.splits, split: photographs})
    resolution = BakeConfig(options.resolution, "paper").resolution_of(run)
    return Study(run, scored, options, resolution, _baselines(run, options.baseline_folders))


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
    large = size_of_rows(run.config)
    for folder in folders:
        _require_same_scene(run, folder)
        row = row_of(read_description(folder).config, large)
        if row == OWN or row in found or row == row_of_run(run.config):
            raise UserError("is a row that is there already" if row != OWN else "is no row of the paper's tables",
                            where=f"--baselines {folder}", expected=", ".join(NAMES[name] for name in NAMES if name != "snerg"),
                            found=NAMES.get(row, "another field"))  # fmt: skip
        found[row] = folder
    return found


def _begun(study: Study) -> dict[str, Any]:
    """The report so far: what an earlier call left, if it was about the same run and photographs."""
    photographs = study.photographs
    camera = photographs[0].camera
    about = {
        "run": str(study.run.path.resolve()), "step": study.run.step, "scene": str(study.scene.path),
        "out": str(study.out.resolve()), "name": study.name, "kind": study.kind, "theirs": whose(study.kind, study.name),
        "downscale": study.run.options.downscale, "split": study.options.split, "views": len(photographs), "width": camera.width,
        "height": camera.height,
    }  # fmt: skip
    if (box := study.options.box) is not None:
        about["aabb"] = list(box)
    kept = read_note(study.out / "report.json")
    same = kept.get("about") == about and isinstance(kept.get("tables"), dict)
    return {"about": about, "tables": kept["tables"] if same else {}, "made": kept.get("made", {}) if same else {}}


def provenance() -> dict[str, str]:
    """What a table was made by: this program's command line, its commit (or version), and the machine."""
    program, *words = sys.argv
    git = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--exclude", "*"]
    commit = ""
    with suppress(OSError, subprocess.SubprocessError):  # no git, or no repository
        commit = subprocess.run(git, capture_output=True, text=True, timeout=30, check=True).stdout.strip()
    cores = f"{os.cpu_count()} x {platform.machine()} cores, JAX on {jax.devices()[0].device_kind}"
    return {
        "command": shlex.join([Path(program).name, *words]), "commit": commit or version("snerg"), "device": cores,
    }  # fmt: skip
