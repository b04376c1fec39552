"""The paper's tables as figures (SNeRG section 6): quality ladder, resolution, storage, sparsity loss.

Each table is {"resolution" (or the rows have it), "rows": [...]}; bytes are of the disk unless they say GPU, times are
seconds or, of frames, milliseconds. What is not known is None.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from baker.reports.codec_report import LADDER, measured
from baker.reports.cross_sections import draw_sections, section, shares
from baker.reports.pack_compare import stored_bytes
from baker.reports.packs import Study
from console import Notice
from scenepack import Pack, load_pack, open_pack
from scenepack.report import pack_facts
from training.journal import read_journal
from viewer.rendering.frame_times import PROTOCOLS, Contender, taking_turns
from viewer.rendering.settings import RenderSettings

Tuned = Literal["none", "view-mlp", "all"]
AXES = "xyz"


def ladder_table(study: Study, rungs: Sequence[Tuned]) -> dict[str, Any]:
    """From the trained field to what is shown: the field, then the bake with each kind of fine-tuning.

    seconds: of training for the field, of baking for the packs.
    """
    trained = [r["training_seconds"] for r in read_journal(study.run.path / "metrics.jsonl") if "training_seconds" in r]
    rows: list[dict[str, Any]] = [
        {"of": "field", **study.score(study.run), "bytes": None, "seconds": trained[-1] if trained else None,
         "picture": study.picture("field")}
    ]  # fmt: skip
    for rung in rungs:
        baked = study.baked(fine_tune=rung)
        rows.append({
            "of": rung, **study.score(baked), "bytes": stored_bytes(baked.path),
            "seconds": sum(baked.seconds.values()), "stages": baked.seconds, "picture": study.picture(baked.name),
        })  # fmt: skip
    return {"resolution": study.options.resolution, "rows": rows}


def resolution_table(
    study: Study, resolutions: Sequence[int], frames: int, size: tuple[int, int] | None
) -> dict[str, Any]:
    """Quality, size and frame time at each resolution. Frames of all of them are drawn in turn (viewer.rendering.frame_times)."""
    shelf = {n: study.baked(resolution=n) for n in resolutions}
    rows, packs = [], {}
    for n, baked in shelf.items():
        pack = packs[str(n)] = load_pack(baked.path)
        rows.append({
            "resolution": n, "grid": list(pack.grid_size), **study.score(baked), "bytes": stored_bytes(baked.path),
            "macroblocks": int(pack.occupied.sum()), "seconds": sum(baked.seconds.values()),
        })  # fmt: skip
    first = str(resolutions[0])
    protocol = "forward-facing" if packs[first].ndc else "synthetic"
    chosen = PROTOCOLS[protocol]
    width, height = size or chosen.size
    cameras = chosen.path(packs[first], frames, chosen.fov, (width, height))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", Notice)
        contenders = [Contender(name, RenderSettings(), pack) for name, pack in packs.items()]
        with taking_turns(packs[first], contenders) as turns:
            turns.warm_up(cameras[0])
            turns.time(cameras)
            gpu_bytes = turns.gpu_bytes
    for warning in caught:
        warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    for row, contender in zip(rows, turns.contenders, strict=True):
        row |= {"gpu_bytes": gpu_bytes[contender.name], "ms_p50": contender.statistics()["ms_p50"]}
    return {
        "rows": rows, "renderer": turns.device, "clock": turns.clock, "frames": frames, "width": width,
        "height": height, "protocol": protocol, "notices": [str(w.message) for w in caught if w.category is Notice],
    }  # fmt: skip


def codecs_table(study: Study, quick: bool) -> dict[str, Any]:
    """One pack written with every codec; the rows are baker.reports.codec_report's."""
    baked = study.baked()
    ladder = [step for step in LADDER if not (quick and step[1] is not None)]
    with tempfile.TemporaryDirectory(prefix="snerg-codecs-") as folder:
        rows = list(measured(baked.path, study.scene, study.split, ladder, Path(folder)))
    return {"resolution": study.options.resolution, "rows": rows}


def sparsity_table(study: Study) -> dict[str, Any]:
    """What the sparsity loss saves, and cross-sections of both grids as pictures.

    Baked with tau_weight 0, as the paper bakes: emptying voxels that no photograph shows would hide the fog that a field
    trained without the loss leaves.
    """
    rows, packs = [], {}
    for run in filter(None, (study.run, study.against)):
        baked = study.baked(run, tau_weight=0.0)
        with open_pack(baked.path) as reader:
            pack = reader.read()
            facts = pack_facts(reader.files, pack)
        label = f"{run.path.resolve().name}, lambda {run.config.sparsity_weight:g}"
        packs[label] = pack
        rows.append({
            "run": str(run.path), "label": label, "step": run.step, "sparsity_weight": run.config.sparsity_weight,
            **study.score(baked), "bytes": facts["bytes"]["disk"], "macroblocks": facts["macroblocks"],
            "voxels": facts["voxels"], "alpha_histogram": facts["alpha_histogram"],
        })  # fmt: skip
    sections = [_sections(study.out, axis, packs) for axis in range(3)]
    return {"resolution": study.options.resolution, "rows": rows, "sections": sections}


def _sections(out: Path, axis: int, packs: dict[str, Pack]) -> dict[str, Any]:
    """Draws the plane through the middle of the first pack, of every pack."""
    first = next(iter(packs.values()))
    at = float(0.5 * (first.min_xyz[axis] + first.max_xyz[axis]))
    cuts = {label: section(pack, axis, at) for label, pack in packs.items()}
    name = f"cross-section-{AXES[axis]}.png"
    draw_sections(out / name, cuts)
    return {
        "axis": AXES[axis],
        "at": at,
        "picture": name,
        "shares": {label: shares(cut) for label, cut in cuts.items()},
    }
