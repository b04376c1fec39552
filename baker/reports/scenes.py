"""Several scenes side by side and their mean, from the reports of each: the appendix's tables of single scenes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baker.reports import paper_figures
from console import UserError
from console.json_text import read_json_file

Table = dict[str, Any]
# Of which table of a report, what, its heading, digits, and by what it is divided. The first three are kept apart by metric.
COLUMNS: Sequence[tuple[str, str, str, int, float]] = (
    ("quality", "psnr", "PSNR (dB)", 2, 1.0),
    ("quality", "ssim", "SSIM", 4, 1.0),
    ("quality", "lpips", "LPIPS", 4, 1.0),
    ("storage", "bytes", "MB on disk", 2, 1e6),
    ("performance", "ms_mean", "milliseconds a frame", 2, 1.0),
    ("performance", "gpu_bytes", "GPU MB", 1, 1e6),
)


def read_report(folder: Path) -> dict[str, Any]:
    """The figures of an earlier report. UserError where the folder holds none."""
    path = folder / "report.json"
    if not path.is_file():
        raise UserError("holds no report", where=folder, expected="the folder of an earlier snerg-report",
                        remedy="measure each run by itself first, then name their folders")  # fmt: skip
    document = read_json_file(path)
    about, tables = (document.get(key) if isinstance(document, dict) else None for key in ("about", "tables"))
    if not isinstance(about, dict) or not isinstance(tables, dict) or not {"name", "kind", "split"} <= set(about):
        raise UserError("is no report of one scene", where=path)
    return document


def scenes_document(reports: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The tables of several reports: {"about", "tables": {"quality psnr": {"rows": [...]}, …}}.

    A row has `values` by scene, their `mean` (None where a scene lacks it), and `paper`, likewise, where the paper prints it.
    UserError where two reports are of one scene.
    """
    names = [report["about"]["name"] for report in reports]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UserError("two reports are of one scene", where="snerg-report", expected="one of each scene", found=twice)
    tables: dict[str, Table] = {}
    for table, key, *_ in COLUMNS:
        if held := {r["about"]["name"]: r for r in reports if table in r["tables"]}:
            tables[f"{table} {key}"] = {"rows": _rows(held, table, key), "scenes": list(held)}
    return {"about": {"scenes": [dict(report["about"]) for report in reports]}, "tables": tables}


def _rows(reports: Mapping[str, Mapping[str, Any]], table: str, key: str) -> list[dict[str, Any]]:
    rows = []
    for name, label in _in_order([report["tables"][table]["rows"] for report in reports.values()]):
        values: dict[str, float | None] = {}
        paper: dict[str, float | None] = {}
        for scene, report in reports.items():
            found = next((row for row in report["tables"][table]["rows"] if row["row"] == name), {})
            values[scene] = found.get(key)
            paper[scene] = _printed(report["about"]["kind"], scene, table, name, key)
        rows.append({
            "row": name, "label": label, "values": values, "mean": mean(list(values.values())), "paper": paper,
            "paper_mean": mean(list(paper.values())),
        })  # fmt: skip
    return rows


def _in_order(tables: Sequence[Sequence[Mapping[str, Any]]]) -> list[tuple[str, str]]:
    """Names and labels of the rows that any table has, each behind the row that it follows where it is first met."""
    order: list[tuple[str, str]] = []
    for rows in tables:
        at = 0
        for row in rows:
            place = next((i for i, (name, _) in enumerate(order) if name == row["row"]), None)
            if place is None:
                own = "the field itself" if row["row"] == "field" else str(row["label"])  # not how long it was trained
                order.insert(at, (row["row"], paper_figures.NAMES.get(row["row"], own)))
                place = at
            at = place + 1
    return order


def _printed(kind: paper_figures.Kind, scene: str, table: str, row: str, key: str) -> float | None:
    """What the paper prints of this very scene."""
    only_means = table == "storage" or (table == "quality" and row in paper_figures.QUALITY_MEANS)
    if only_means or not paper_figures.place_of(kind, scene):
        return None
    if table == "quality":
        return (paper_figures.quality(kind, scene, row) or {}).get(key)
    printed = paper_figures.performance(kind, scene, "ours" if row == "paper" else row) or {}
    gigabytes = printed.get("gpu_gb")
    return printed.get("ms") if key == "ms_mean" else None if gigabytes is None else 1e9 * gigabytes


def mean(values: Sequence[float | None]) -> float | None:
    """None where one is not known."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known and len(known) == len(values) else None
