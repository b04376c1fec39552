"""Tables 1 and the appendix's of resolution: how long frames take, and what they take of the card, by the paper's protocol."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from baker.reports import paper_figures
from baker.reports.options import ReportOptions
from baker.reports.report_cache import Study
from baker.reports.tables import against_command
from console import Notice
from scenepack import Pack, load_pack
from scenepack.files import stored_bytes
from viewer.benchmark.frames import Contender, Turns, same_view, sustained, taking_turns
from viewer.benchmark.protocols import Flight, flight, protocol_for
from viewer.rendering.settings import RenderSettings

Row = dict[str, Any]
LABELS = {
    "ours": "ours: our bake, our marcher",
    "no-mlp": "1) no view MLP",
    "no-sparsity": "2) no sparsity loss (our bake, which prunes its fog)",
    "mlp-per-sample": "3) view MLP at every sample",
    "paper-marcher": "our bake, the paper's marcher",
    "paper": "the paper's bake, the paper's marcher",
}


def performance_table(study: Study) -> dict[str, Any]:
    """Table 1: our marcher and its ablations, and the paper's marcher on our pack and on the paper's. Frames alternate."""
    ours, theirs = study.baked("snerg"), study.baked("paper")
    pack, papers = load_pack(ours.path), load_pack(theirs.path)
    contenders = {
        "ours": Contender("ours", RenderSettings()),
        "paper-marcher": Contender("paper-marcher", RenderSettings(marcher="paper")),
        "paper": Contender("paper", RenderSettings(marcher="paper"), papers),
    }
    if pack.view_mlp is not None:
        contenders["no-mlp"] = Contender("no-mlp", RenderSettings(mode="diffuse"))
        contenders["mlp-per-sample"] = Contender("mlp-per-sample", RenderSettings(view_mlp_per_sample=True))
    if study.without_sparsity is not None:
        dense = study.baked("snerg", study.without_sparsity)
        contenders["no-sparsity"] = Contender("no-sparsity", RenderSettings(), load_pack(dense.path))
    measured, about = timed(pack, list(contenders.values()), study.options)
    rows: list[Row] = []
    for name, label in LABELS.items():
        row: Row = {"row": name, "label": label}
        if name in measured:
            row |= measured[name]
        elif name == "no-sparsity":
            row["command"] = against_command(study)
        else:
            row["command"] = "none: this field has no view MLP"
        printed = paper_figures.performance(study.kind, study.name, "ours" if name == "paper" else name)
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
    first = next(iter(packs.values()))
    contenders = [Contender(name, RenderSettings(), pack) for name, pack in packs.items()]
    measured, about = timed(first, contenders, replace(study.options, power_seconds=0.0))
    for row in rows:
        row |= measured.get(row["row"], {})
    return {"preset": preset, "rows": rows, **about}


def timed(
    pack: Pack, contenders: Sequence[Contender], options: ReportOptions
) -> tuple[Mapping[str, Row], dict[str, Any]]:
    """ms_mean, ms_std, ms_p50, fps, gpu_bytes, watts and fps_per_watt of contenders by name, and fps_per_nominal_watt where that
    power was given; and device, clock and path."""
    flown = flight(pack, protocol_for(pack), options.frames, size=options.pixels, distance=options.distance)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", Notice)
        with taking_turns(pack, contenders) as turns:
            turns.warm_up(flown.cameras[0])
            turns.time(flown.cameras)
            power = {c.name: _power(turns, c, flown, options.power_seconds) for c in turns.contenders}
            gpu_bytes = turns.gpu_bytes
    for warning in caught:
        warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    rows = {}
    for contender in turns.contenders:
        times = contender.statistics()
        kept = {key: times[key] for key in ("ms_mean", "ms_std", "ms_p50", "fps")}
        if options.nominal_watts is not None:
            kept["fps_per_nominal_watt"] = times["fps"] / options.nominal_watts
        rows[contender.name] = {**kept, "gpu_bytes": gpu_bytes[contender.name], **power[contender.name]}
    notices = [str(w.message) for w in caught if w.category is Notice]
    return rows, {
        "renderer": turns.device, "clock": turns.clock, "frames": options.frames, **flown.facts, "notices": notices,
    }  # fmt: skip


def _power(turns: Turns, contender: Contender, flown: Flight, seconds: float) -> Row:
    """watts and fps_per_watt while a contender draws without a pause; None where no card tells them."""
    if seconds <= 0 or "nvidia" not in turns.device.lower():
        return {"watts": None, "fps_per_watt": None}
    own = contender.pack or turns.pack
    views = [same_view(camera, turns.pack, own) for camera in flown.cameras]
    times = sustained(turns.drawn_by[contender.name], views, contender.settings, seconds)
    return {key: times[key] for key in ("watts", "fps_per_watt")}
