"""The SNeRG paper's tables of one run (section 7 and its appendix), measured one after another and kept in the report's folder.

Each table is {"rows": [...], ...}. A row has `row`, its key, and `label`; psnr, ssim, lpips where it was measured, and bytes (on
disk, unless they say GPU); or `command`, which would make what it needs. `paper` and `release` are theirs, from
baker.reports.paper_figures. What is not known is None. Times are seconds or, of frames, milliseconds.
"""

import json
import os
import platform
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from baker.baking.bake import check_bake
from baker.baking.config import BakeConfig, Quality
from baker.reports import paper_figures
from baker.reports.evaluation import evaluate, photographs_of
from baker.reports.fields import OWN, label_of, row_of, row_of_run, size_of_rows, train_command
from baker.reports.figures import FIGURES, draw_figure, draw_report_plots, draw_sections, section, shares
from baker.reports.options import ReportOptions
from baker.reports.pack_compare import compare_packs
from baker.reports.pages import FIGURES_NAME, report_text
from baker.reports.paper_figures import NAMES, whose
from baker.reports.report_cache import Baked, Score, Study, read_note
from console import UserError, write_json, write_result
from console.errors import handle_notices
from scenepack import Pack, load_pack, open_pack, save_pack
from scenepack.codecs import chosen_quality, codec_named
from scenepack.files import stored_bytes
from scenepack.report import pack_facts
from scenepack.writer import program_version
from training.recorder import read_metrics
from training.run import Run, load_run, read_description
from viewer.benchmark.frames import Contender, Turns, same_view, sustained, taking_turns
from viewer.benchmark.protocols import Flight, flight, protocol_for
from viewer.rendering.settings import RenderSettings

# Each codec as it comes, and what places them on one curve.
LADDER: tuple[tuple[str, int | None], ...] = (
    ("png", None), ("webp", None), ("jpeg", 98), ("jpeg", None), ("jpeg", 90), ("h264", 92), ("h264", None), ("h264", 70),
    ("avif", 90), ("avif", None), ("avif", 70), ("avif", 60),
)  # fmt: skip
VIEWS, SIZE = 8, (400, 400)


def measured(
    path: Path, scene: Any, split: str, ladder: Sequence[tuple[str, int | None]], folder: Path, mask_of: Path | None = None
) -> Iterator[dict[str, Any]]:  # fmt: skip
    """A row for each (codec, quality) of the ladder, written below `folder`: bytes on disk, PSNR, SSIM and LPIPS against the
    photographs, PSNR against the pictures of the pack as it was, seconds to encode and to decode. mask_of: see evaluate.

    Codecs whose library is missing are left out with a line on stderr.
    """
    pack = load_pack(path)
    for name, asked in ladder:
        try:
            quality = chosen_quality(codec_named(name, "codec"), asked)
        except UserError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        target = folder / "pack"
        encoding = time.perf_counter()
        save_pack(pack, target, codec=name, quality=quality)
        decoding = time.perf_counter()
        load_pack(target)
        done = time.perf_counter()
        shown = evaluate(target, scene, split, mask_of=mask_of)
        against = compare_packs(path, target, VIEWS, SIZE)
        yield {
            "codec": name, "quality": quality, "default": asked is None, "bytes": stored_bytes(target), **_metrics(shown),
            "psnr_against_pack": against["psnr"], "encode_s": decoding - encoding, "decode_s": done - decoding,
        }  # fmt: skip


Row = dict[str, Any]
BEFORE = ("jaxnerf-plus", "jaxnerf", "tinyview", "deferred")  # rows above the baked ones, as in the paper
SNERG = {
    "float": "SNeRG (float): baked, not yet quantised",
    "8-bit": "SNeRG (PNG, no FT): 8 bits",
    "snerg": "SNeRG (PNG): view MLP fine-tuned",
    "no-sparsity": "SNeRG (PNG, no L_s)",
}
CODECS = {"png": "PNG", "webp": "WebP", "jpeg": "JPEG", "h264": "H264", "avif": "AVIF"}
OURS: Mapping[Quality, str] = {
    "draft": "ours: pruned, not tuned",
    "compact": "ours: pruned and tuned in coarser steps",
    "full": "ours: pruned and tuned in 8 bits",
}


def quality_table(study: Study) -> dict[str, Any]:
    """Table 2: from trained fields to what is shown."""
    rows = [
        *(field_row(study, name) for name in (*BEFORE, *own_row(study))),
        _beside(study, {"row": "float", "label": SNERG["float"], **study.score_floats()}),
        _baked_row(study, "8-bit", SNERG["8-bit"], study.baked("paper", quality="draft")),
        _baked_row(study, "snerg", SNERG["snerg"], study.baked("paper")),
        no_sparsity_row(study),
        *(_baked_row(study, f"ours-{own}", OURS[own], study.baked("snerg", quality=own)) for own in study.options.qualities),
        field_row(study, "diffuse"),
    ]  # fmt: skip
    return {"resolution": study.resolution, "field": label_of(study.run.config, study.run.step), "rows": rows}


def storage_table(study: Study) -> dict[str, Any]:
    """Table 3: one pack written with every codec, the grid of floats above, and networks below."""
    preset = study.options.bake
    floats, baked = study.score_floats(), study.baked(preset)
    rows = [_stored(study, {"row": "float", "label": SNERG["float"], **floats}), _stored(study, no_sparsity_row(study))]
    ladder = [step for step in LADDER if not (study.options.quick and step[1] is not None)]
    with tempfile.TemporaryDirectory(prefix="snerg-codecs-") as folder:
        mask_of = None if study.mask is None else study.mask.path
        for row in measured(baked.path, study.scene, study.options.split, ladder, Path(folder), mask_of):
            lossless = row["quality"] is None
            key = row["codec"] if row["default"] or lossless else f"{row['codec']} {row['quality']}"
            whose = "SNeRG" if preset == "paper" else "ours"
            label = f"{whose} ({CODECS[row['codec']]}{', lossless' if lossless else ''})"
            rows.append(_stored(study, {"row": key, "label": label, **row}))
    for name in ("jaxnerf-plus", "jaxnerf"):
        row = field_row(study, name)
        if "psnr" in row:
            run = load_run(study.baselines[name], scene_path=study.scene.path)
            # 4 bytes a number, as the paper measures it
            row["bytes"] = 4 * sum(int(leaf.size) for leaf in jax.tree.leaves(run.state.params))
        rows.append(_stored(study, row))
    return {"resolution": study.resolution, "preset": preset, "rows": rows}


def sparsity_table(study: Study) -> dict[str, Any]:
    """Figure 4: what the sparsity loss and the culling of hidden macroblocks save, and cross-sections of the grids as pictures.

    Of the paper's bakes: emptying voxels that no photograph shows would hide the fog of a field trained without it.
    """
    rows, packs = [], {}
    for name, run in (("with", study.run), ("without", study.without_sparsity), ("hidden", study.without_sparsity)):
        if run is None:
            continue
        baked = study.baked("paper", run, keeps_hidden=name == "hidden")
        with open_pack(baked.path) as reader:
            pack = reader.read()
            facts = pack_facts(reader.files, pack)
        label = f"{run.path.resolve().name}, lambda {run.config.sparsity_weight:g}"
        label += ", hidden macroblocks kept" if name == "hidden" else ""
        packs[label] = pack
        rows.append({
            "row": name, "run": run.path.resolve().name, "label": label,
            "field": label_of(run.config, run.step), "sparsity_weight": run.config.sparsity_weight,
            **study.score(baked), "bytes": facts["bytes"]["disk"], "macroblocks": facts["macroblocks"],
            "voxels": facts["voxels"], "alpha_histogram": facts["alpha_histogram"],
        })  # fmt: skip
    if study.options.against is None:
        rows.append({"row": "without", "label": "no sparsity loss", "command": against_command(study)})
    sections = [_sections(study.out, axis, packs) for axis in range(3)]
    return {"resolution": study.resolution, "rows": rows, "sections": sections}


def field_row(study: Study, name: str, mask_of: Baked | None = None) -> Row:
    """A row of a field, by its key: scored, or with the command that would train it."""
    is_own, path = row_of_run(study.run.config) == name, study.baselines.get(name)
    if not is_own and path is None:
        command = train_command(study.run, study.out, name, "--baselines")
        return _beside(study, {"row": name, "label": paper_figures.NAMES[name], "command": command})
    run = study.run if is_own or path is None else load_run(path, scene_path=study.scene.path)
    times = [row["training_seconds"] for row in read_metrics(run.path / "metrics.jsonl") if "training_seconds" in row]
    row = {"row": name, "label": label_of(run.config, run.step), "seconds": times[-1] if times else None}
    return _beside(study, row | study.score_field("field" if is_own else name, run, mask_of))


def own_row(study: Study) -> list[str]:
    """The key of the run's row where the paper has no such field."""
    return [OWN] if row_of_run(study.run.config) == OWN else []


def _baked_row(study: Study, row: str, label: str, baked: Baked) -> Row:
    return _beside(study, {
        "row": row, "label": label, **study.score(baked), "bytes": stored_bytes(baked.path),
        "seconds": sum(baked.seconds.values()), "stages": baked.seconds, "pack": baked.name,
    })  # fmt: skip


def no_sparsity_row(study: Study) -> Row:
    """The paper's bake of the run without the sparsity loss."""
    if (run := study.without_sparsity) is None:
        return _beside(study, {"row": "no-sparsity", "label": SNERG["no-sparsity"], "command": against_command(study)})
    return _baked_row(study, "no-sparsity", SNERG["no-sparsity"], study.baked("paper", run))


def against_command(study: Study) -> str:
    """What would train the run without the sparsity loss."""
    return train_command(study.run, study.out, "no-sparsity", "--against")


def _beside(study: Study, row: Row) -> Row:
    """The row with what the paper and the release print of it."""
    paper = paper_figures.quality(study.kind, study.name, row["row"])
    theirs = paper_figures.release(study.kind, study.name, row["row"])
    return row | {"paper": paper, "release": None if theirs is None else {"psnr": theirs}}


def _stored(study: Study, row: Row) -> Row:
    return row | {"paper": paper_figures.storage(study.kind, row["row"]), "release": None}


def _sections(out: Path, axis: int, packs: dict[str, Pack]) -> dict[str, Any]:
    """Draws the plane through the middle of the first pack, of every pack."""
    first, letter = next(iter(packs.values())), "xyz"[axis]
    at = float(0.5 * (first.min_xyz[axis] + first.max_xyz[axis]))
    cuts = {label: section(pack, axis, at) for label, pack in packs.items()}
    name = f"cross-section-{letter}.png"
    draw_sections(out / name, cuts)
    return {"axis": letter, "at": at, "picture": name, "shares": {label: shares(cut) for label, cut in cuts.items()}}


# --- Real scenes: compared everywhere, and, as the paper does for 360° scenes, where the paper's bake is opaque ---


def real_table(study: Study) -> dict[str, Any]:
    """Rows of fields and packs: psnr, ssim, lpips of whole pictures; `masked`: the same where the paper's pack is opaque."""
    paper, ours = study.baked("paper"), study.baked("snerg")
    rows = [_masked_field(study, name, paper) for name in ("jaxnerf-plus", "deferred", *own_row(study))]
    rows += [
        _beside(study, {"row": row, "label": label, **study.score(baked), "masked": _metrics(study.score(baked, paper)),
                        "bytes": stored_bytes(baked.path)})
        for row, label, baked in (("snerg", SNERG["snerg"], paper), ("ours-full", OURS["full"], ours))
    ]  # fmt: skip
    rows.append(_masked_field(study, "diffuse", paper))
    return {
        "resolution": study.resolution, "rows": rows, "field": label_of(study.run.config, study.run.step),
        "paper_is_masked": study.kind == "real360",
    }  # fmt: skip


def _masked_field(study: Study, name: str, paper: Baked) -> Row:
    row = field_row(study, name)
    return row if "psnr" not in row else row | {"masked": _metrics(field_row(study, name, paper))}


def _metrics(score: Score) -> Score:
    return {metric: score[metric] for metric in ("psnr", "ssim", "lpips")}


# --- How long frames take, and what they take of the card, by the paper's protocol ---

POWER_SECONDS = 4.0  # of drawing without a pause to measure the power of an NVIDIA card, for each row
LABELS = {
    "ours": "ours: our bake, our marcher",
    "no-mlp": "1) no view MLP",
    "no-sparsity": "2) no sparsity loss (our bake, which prunes its fog)",
    "mlp-per-sample": "3) view MLP at every sample",
    "paper-marcher": "our bake, the paper's marcher",
    "paper": "the paper's bake, the paper's marcher",
    "paper-mlp-per-sample": "3) the same, view MLP at every sample",
}
PRINTED = {"paper": "ours", "paper-mlp-per-sample": "mlp-per-sample"}  # the paper's names of these rows


def performance_table(study: Study) -> dict[str, Any]:
    """Table 1: our marcher and its ablations, and the paper's marcher on our pack and on the paper's. Frames alternate."""
    ours, theirs = study.baked("snerg"), study.baked("paper")
    pack, papers = load_pack(ours.path), load_pack(theirs.path)
    contenders = [
        Contender("ours", RenderSettings(), pack),
        Contender("paper-marcher", RenderSettings(marcher="paper"), pack),
        Contender("paper", RenderSettings(marcher="paper"), papers),
    ]
    if pack.view_mlp is not None:
        contenders.append(Contender("no-mlp", RenderSettings(mode="diffuse"), pack))
        contenders.append(Contender("mlp-per-sample", RenderSettings(view_mlp_per_sample=True), pack))
        each = RenderSettings(marcher="paper", view_mlp_per_sample=True)
        contenders.append(Contender("paper-mlp-per-sample", each, papers))
    if study.without_sparsity is not None:
        dense = study.baked("snerg", study.without_sparsity)
        contenders.append(Contender("no-sparsity", RenderSettings(), load_pack(dense.path)))
    timings, about = timed(contenders, study.options, POWER_SECONDS)
    rows: list[Row] = []
    for name, label in LABELS.items():
        missing = against_command(study) if name == "no-sparsity" else "none: this field has no view MLP"
        printed = paper_figures.performance(study.kind, study.name, PRINTED.get(name, name))
        row = {"row": name, "label": label, **timings.get(name, {"command": missing})}
        rows.append(row | {"paper": printed, "release": None})
    return {"resolution": study.resolution, "rows": rows, **about}


def resolution_table(study: Study) -> dict[str, Any]:
    """Quality, size and frame time at each resolution, with and without the sparsity loss. Frames of all are drawn in turn."""
    preset, rows = study.options.bake, list[Row]()
    packs: dict[str, Pack] = {}
    for n in reversed(study.options.sides):
        for run in (study.run, study.without_sparsity):
            is_own = run is study.run
            row: Row = {"row": f"{n}" if is_own else f"{n}, no L_s", "resolution": n, "sparsity": is_own}
            row["label"] = f"{n}³{'' if is_own else ', no sparsity loss'}"
            if run is None:
                row["command"] = against_command(study)
            else:
                baked = study.baked(preset, run, resolution=n)
                packs[row["row"]] = load_pack(baked.path)
                row |= study.score(baked) | {
                    "grid": list(packs[row["row"]].grid_size), "bytes": stored_bytes(baked.path),
                    "macroblocks": int(packs[row["row"]].occupied.sum()), "seconds": sum(baked.seconds.values()),
                }  # fmt: skip
            printed = paper_figures.RESOLUTION.get(n) if study.kind == "synthetic" and is_own else None
            named = None if printed is None else dict(zip(("psnr", "ssim", "lpips", "fps", "mb"), printed, strict=True))
            rows.append(row | {"paper": named, "release": None})
    contenders = [Contender(name, RenderSettings(), pack) for name, pack in packs.items()]
    timings, about = timed(contenders, study.options)
    for row in rows:
        row |= timings.get(row["row"], {})
    return {"preset": preset, "rows": rows, **about}


def timed(
    contenders: Sequence[Contender], options: ReportOptions, power_seconds: float = 0.0
) -> tuple[Mapping[str, Row], dict[str, Any]]:
    """ms_mean, ms_std, ms_p50, fps, gpu_bytes, watts and fps_per_watt of contenders by name, and fps_per_nominal_watt where that
    power was given; and device, clock and path."""
    pack = contenders[0].pack
    flown = flight(pack, protocol_for(pack), options.frames, size=options.pixels)
    notices: list[str] = []
    with handle_notices(notices.append, show_too=True), taking_turns(contenders) as turns:
        turns.warm_up(flown.cameras[0])
        turns.time(flown.cameras)
        power = {c.name: _power(turns, c, flown, power_seconds) for c in turns.contenders}
    rows = {}
    for contender in turns.contenders:
        times = contender.statistics()
        kept = {key: times[key] for key in ("ms_mean", "ms_std", "ms_p50", "fps", "gpu_bytes")}
        if options.nominal_watts is not None:
            kept["fps_per_nominal_watt"] = times["fps"] / options.nominal_watts
        rows[contender.name] = {**kept, **power[contender.name]}
    return rows, {
        "renderer": turns.device, "clock": turns.clock, "frames": options.frames, **flown.facts, "notices": notices,
    }  # fmt: skip


def _power(turns: Turns, contender: Contender, flown: Flight, seconds: float) -> Row:
    """watts and fps_per_watt while a contender draws without a pause; None where no card tells them."""
    if seconds <= 0 or "nvidia" not in turns.device.lower():
        return {"watts": None, "fps_per_watt": None}
    views = [same_view(camera, turns.contenders[0].pack, contender.pack) for camera in flown.cameras]
    times = sustained(turns.drawn_by[contender.name], views, contender.settings, seconds)
    return {key: times[key] for key in ("watts", "fps_per_watt")}


# --- The report ---


def write_tables(study: Study, chosen: Sequence[str]) -> None:
    """Makes the tables `chosen`, of baker.reports.options.TABLES, and writes the report anew after each.

    UserError, before anything is baked, where a resolution cannot be.
    """
    for side in (study.resolution, *study.options.sides):
        study.config("paper", resolution=side).check()
    document = _begun(study)
    makers = {
        "quality": quality_table, "storage": storage_table, "performance": performance_table,
        "resolution": resolution_table, "sparsity": sparsity_table, "real": real_table,
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
        "command": shlex.join([Path(program).name, *words]), "commit": commit or program_version(), "device": cores,
    }  # fmt: skip
