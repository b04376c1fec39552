"""Reports as Markdown, for people to read: what was measured of one scene, beside what the paper and the release print; or, from
the reports of several scenes, these side by side and their mean, as in the appendix's tables of single scenes.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from baker.metrics import mean
from baker.reports import paper_figures
from console import UserError
from console.json_text import read_json_file
from console.progress import duration

Table = Mapping[str, Any]
Row = Mapping[str, Any]
Cell = Callable[[Row], str]
Column = tuple[str, Cell]  # its heading, and what it says of a row
NONE = "–"
FIGURES_NAME = "figures"  # of a table: the pictures beside it
NO_SUCH_FIELD = "It shares the head and the sparsity term of the paper's deferred NeRF, but is not that field."


def number(value: float | None, digits: int = 2, unit: float = 1.0) -> str:
    """A figure in `unit` as the text of a cell; a dash for None."""
    return NONE if value is None else f"{value / unit:,.{digits}f}"


def _italic(text: str) -> str:
    return text if text == NONE else f"*{text}*"


def _figure(key: str, digits: int, unit: float = 1.0) -> Cell:
    return lambda row: number(row.get(key), digits, unit)


def _theirs(key: str, digits: int, unit: float = 1.0, source: str = "paper") -> Cell:
    return lambda row: _italic(number((row.get(source) or {}).get(key), digits, unit))


def _took(row: Row) -> str:
    return NONE if row.get("seconds") is None else duration(row["seconds"])


LABEL: Column = ("", lambda row: row["label"])
SCORES: list[Column] = [("PSNR (dB)", _figure("psnr", 2)), ("SSIM", _figure("ssim", 4)), ("LPIPS", _figure("lpips", 4))]
PAPER: list[Column] = [
    ("*paper:* PSNR", _theirs("psnr", 2)), ("*SSIM*", _theirs("ssim", 3)), ("*LPIPS*", _theirs("lpips", 3)),
]  # fmt: skip
RELEASE: Column = ("*release:* PSNR", _theirs("psnr", 2, source="release"))
MB: Column = ("MB", _figure("bytes", 2, 1e6))
GPU_MB: Column = ("GPU MB", _figure("gpu_bytes", 1, 1e6))
FPS: Column = ("FPS", _figure("fps", 1))


def table_of(rows: Iterable[Row], *columns: Column) -> str:
    """A table of these columns, in Markdown."""
    return markdown_table([heading for heading, _ in columns], ([cell(row) for _, cell in columns] for row in rows))


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table: words in the first column, numbers in the others."""
    lines = [f"| {' | '.join(headings)} |", "| --- |" + " ---: |" * (len(headings) - 1)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def report_text(document: Mapping[str, Any]) -> str:
    """report.md of one scene: a section for each table that was made, in the order of SECTIONS."""
    about = document["about"]
    lines = [
        f"# {about['name']}",
        "",
        f"The run {about['run']}, {about['step']} steps on {about['scene']}. Scores are means of {about['views']} "
        f"{about['split']} photographs of {about['width']} x {about['height']} pixels; packs are drawn by the OpenGL renderer. "
        "MB are 10⁶ bytes.",
        "",
        f"Columns in *italics* are not ours: the paper's and its release's own figures, of {about['theirs']}, measured on their "
        "machines.",
    ]
    if box := about.get("aabb"):
        corners = ",".join(f"{value:g}" for value in box)
        lines += ["", f"All packs are baked of the box {corners}. All scores compare photographs and pictures only where the "
                  "paper's bake of it is opaque, as the paper does for real 360° scenes."]  # fmt: skip
    for _, title, section in sections(document):
        lines += ["", f"## {title}", "", *section]
    return "\n".join(lines) + "\n"


def sections(document: Mapping[str, Any], *, figures: bool = True) -> Iterator[tuple[str, str, list[str]]]:
    """Name, title and Markdown of each table that was made, in the order of SECTIONS. figures: with pictures of views."""
    for name, (title, section) in SECTIONS.items():
        if name in document["tables"]:
            table = document["tables"][name]
            shown = table if figures else {key: value for key, value in table.items() if key != FIGURES_NAME}
            yield name, title, section(shown, document["about"])


# --- Several scenes side by side ---

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


def scenes_text(document: Mapping[str, Any]) -> str:
    """report.md of several scenes."""
    names = [about["name"] for about in document["about"]["scenes"]]
    return "\n".join([f"# {', '.join(names)}", "", *scenes_tables(document, "##")]) + "\n"


def scenes_tables(document: Mapping[str, Any], heading: str) -> list[str]:
    """Each column of COLUMNS that there is, as a table of rows by scenes. heading: Markdown's mark of the level of theirs."""
    lines = [
        "Rows in *italics* are the paper's own figures, of the same scenes. A mean is given where every scene has the figure."
    ]
    for table, key, title, digits, unit in COLUMNS:
        if (made := document["tables"].get(f"{table} {key}")) is None:
            continue
        scenes, cells = made["scenes"], []
        for row in made["rows"]:
            values = [row["mean"], *(row["values"][scene] for scene in scenes)]
            cells.append([row["label"], *(number(value, digits, unit) for value in values)])
            if any(value is not None for value in row["paper"].values()):
                values = [row["paper_mean"], *(row["paper"][scene] for scene in scenes)]
                numbers = (_italic(number(value, digits, unit)) for value in values)
                cells.append([f"*{row['label']}, the paper*", *numbers])
        lines += ["", f"{heading} {title}", "", markdown_table(["", "mean", *scenes], cells)]
    return lines


# --- The tables of one scene ---


def _to_fill(rows: Iterable[Row]) -> list[str]:
    """Below a table: the command for each row without a run. What follows "; then add" is an option of the report; see
    baker.reports.fields.train_command."""
    missing = [row for row in rows if row.get("command")]
    commands = [row["command"].replace("; then add ", "`, then add `") for row in missing]
    lines = [f"- {row['label']}: `{command}`" for row, command in zip(missing, commands, strict=True)]
    return ["", "Rows without a run, and what would make them:", "", *lines] if lines else []


def _quality(table: Table, about: Mapping[str, Any]) -> list[str]:
    rows = table["rows"]
    fields = {row["row"]: row["psnr"] for row in rows if row["row"] in ("field", "deferred") and "psnr" in row}
    field = fields.get("field", fields.get("deferred"))

    def gap(row: Row) -> str:
        return NONE if field is None or "psnr" not in row else f"{row['psnr'] - field:+.2f}"

    columns = [LABEL, *SCORES, ("against the field (dB)", gap), MB, ("time", _took), *PAPER, RELEASE]
    own = NO_SUCH_FIELD if table["field"].startswith(("multi-resolution field", "voxel field")) else ""
    printed = [row for row in rows if row.get("paper") and row["row"] in paper_figures.QUALITY_MEANS]
    means = ", ".join(str(row["label"]).split(":")[0] for row in printed)
    lines = [
        f"Packs of {table['resolution']} voxels along the longest side, baked from: {table['field']}. {own}".strip(), "",
        table_of(rows, *columns), "",
        "SNeRG rows are baked as the paper writes (`snerg-bake --preset paper`), ours by default settings. Time is of training "
        "for fields, of baking for packs."
        + (f" The paper prints {means} as means over its synthetic scenes only." if means else ""),
        *_to_fill(rows),
    ]  # fmt: skip
    for name, figure in table.get(FIGURES_NAME, {}).items():
        lines += ["", f"![{name}: {figure['view']}]({figure['picture']})", ""]
        lines.append(f"View {figure['view']}, and a crop of it where the first and the last picture differ most. PSNR of the "
                     "whole view in brackets.")  # fmt: skip
    return lines


def codec_columns(png_bytes: int) -> list[Column]:
    """Columns for rows of baker.reports.report.measured. png_bytes: what the pack takes as PNG."""

    def quality(row: Row) -> str:
        if "codec" not in row:
            return NONE
        return "lossless" if row["quality"] is None else f"{row['quality']}{' (default)' if row.get('default') else ''}"

    def against_pack(row: Row) -> str:
        against = row.get("psnr_against_pack")
        return "identical" if against is not None and against >= 119 else number(against, 2)

    return [
        ("quality", quality), MB,
        ("of PNG", lambda row: NONE if row.get("bytes") is None else f"{100 * row['bytes'] / png_bytes:.0f} %"), *SCORES,
        ("PSNR against the pack (dB)", against_pack),
        ("encode (s)", _figure("encode_s", 1)), ("decode (s)", _figure("decode_s", 1)),
    ]  # fmt: skip


def _storage(table: Table, about: Mapping[str, Any]) -> list[str]:
    rows, png_bytes = table["rows"], next(row["bytes"] for row in table["rows"] if row["row"] == "png")
    theirs = [("*paper:* MB", _theirs("mb", 1)), ("*PSNR*", _theirs("psnr", 2)), *PAPER[1:]]
    kind = "as the paper writes, view MLP fine-tuned" if table["preset"] == "paper" else "by our default settings"
    return [
        f"Packs of {table['resolution']} voxels along the longest side, baked {kind}; the row of floats is the paper's bake "
        "before it is quantised. Bytes of networks and floats are 4 a number. The paper prints this table as means over "
        f"{paper_figures.KINDS[about['kind']]}.",
        "", table_of(rows, LABEL, *codec_columns(png_bytes), *theirs), *_to_fill(rows), "",
        "![PSNR over megabytes, by codec](storage.png)",
    ]  # fmt: skip


def _device(table: Table) -> list[str]:
    orbit = "" if table["distance"] is None else f", orbit at {table['distance']:.4g} ({table['distance_from']})"
    return [
        f"Frame times: {table['renderer']}; {table['clock']}; {table['width']} x {table['height']} pixels, path "
        f"{table['protocol']}{orbit}, {table['frames']} frames, each drawn by every row in turn.",
        *(f"Note: {notice}." for notice in table["notices"]),
    ]


SPEED_ROW = "*{:.2f}* *{:.3f}* *{:.3f}* *{:g}* *{:g}* *{:.5f}*"  # of paper_figures.SPEED


def _performance(table: Table, about: Mapping[str, Any]) -> list[str]:
    def frame(row: Row) -> str:
        return NONE if row.get("ms_mean") is None else f"{row['ms_mean']:.2f} ± {row['ms_std']:.2f}"

    nominal = [("FPS/W, nominal", _figure("fps_per_nominal_watt", 5))]
    columns = [
        LABEL, ("ms a frame", frame), ("p50 (ms)", _figure("ms_p50", 2)), FPS, ("FPS/W", _figure("fps_per_watt", 3)),
        *(nominal if any("fps_per_nominal_watt" in row for row in table["rows"]) else []), GPU_MB,
        ("*paper:* ms a frame", _theirs("ms", 1)), ("*FPS*", _theirs("fps", 1)), ("*GPU MB*", _theirs("gpu_gb", 0, 1e-3)),
    ]  # fmt: skip
    lines = [
        f"Packs of {table['resolution']} voxels along the longest side. ± is over frames. The paper measured its whole system "
        "(its bake and its marcher) on a laptop with an 85 W AMD Radeon Pro 5500M.",
        "", table_of(table["rows"], *columns), "", *_device(table), *_to_fill(table["rows"]),
    ]  # fmt: skip
    if speed := paper_figures.SPEED.get(about["kind"]):
        kind = paper_figures.KINDS[about["kind"]]
        lines += ["", f"What the paper prints of itself and of others, of {kind} (not measured here):", ""]
        names = (f"*{paper_figures.NAMES.get(name, name)}*" for name in speed)
        rows = [[name, *SPEED_ROW.format(*row).split()] for name, row in zip(names, speed.values(), strict=True)]
        lines.append(markdown_table(["*method*", "*PSNR*", "*SSIM*", "*LPIPS*", "*W*", "*FPS*", "*FPS/W*"], rows))
    return lines


def _resolution(table: Table, about: Mapping[str, Any]) -> list[str]:
    columns = [
        ("voxels", LABEL[1]), *SCORES, MB, ("macroblocks", _figure("macroblocks", 0)), GPU_MB,
        ("p50 of exact (ms)", _figure("ms_p50", 1)), FPS, ("bake", _took),
        *PAPER, ("*FPS*", _theirs("fps", 2)), ("*MB*", _theirs("mb", 1)),
    ]  # fmt: skip
    kind = "as the paper writes" if table["preset"] == "paper" else "by our default settings"
    return [
        f"Baked {kind}. The paper prints this table as means over its synthetic scenes, with the sparsity loss.",
        "", table_of(table["rows"], *columns), "", *_device(table), *_to_fill(table["rows"]), "",
        "![Quality, size and frame time over the resolution](resolution.png)",
    ]  # fmt: skip


def _real(table: Table, about: Mapping[str, Any]) -> list[str]:
    def masked(heading: str, cell: Cell) -> Column:
        return heading, lambda row: cell(row.get("masked") or {})

    headings = ("masked: PSNR", "SSIM", "LPIPS")
    columns = [LABEL, *SCORES, *(masked(heading, cell) for heading, (_, cell) in zip(headings, SCORES, strict=True))]
    return [
        f"Packs of {table['resolution']} voxels along the longest side, baked from: {table['field']}. Masked: photographs and "
        "pictures of all rows are compared where the paper's bake is opaque, as the paper does for 360° scenes. Its own "
        f"figures here are {'masked' if table['paper_is_masked'] else 'of whole pictures'}.",
        "", table_of(table["rows"], *columns, *PAPER, RELEASE), *_to_fill(table["rows"]),
    ]  # fmt: skip


def _sparsity(table: Table, about: Mapping[str, Any]) -> list[str]:
    def run(row: Row) -> str:
        hidden = ", hidden macroblocks kept" if row["row"] == "hidden" else ""
        return f"{row['run']}: {row['field']}{hidden}" if "run" in row else row["label"]

    def share(key: str, part: str) -> Cell:
        return lambda row: f"{row[key][part]} of {row[key]['grid']}" if key in row else NONE

    columns = [
        ("run", run), ("lambda", lambda row: f"{row['sparsity_weight']:g}" if "run" in row else NONE), *SCORES, MB,
        ("macroblocks", share("macroblocks", "occupied")), ("voxels with alpha", share("voxels", "with_alpha")),
    ]  # fmt: skip
    lines = [
        f"Baked at {table['resolution']} voxels as the paper writes: our own bake empties voxels that no photograph shows, and "
        "with them the fog that a field trained without the loss leaves.",
        "", table_of(table["rows"], *columns), *_to_fill(table["rows"]), "", "![Opacity of stored voxels](sparsity.png)", "",
        "Cross-sections through the middle: above, opacity (ink is the square root of alpha, so that fog is seen; "
        "stored macroblocks are blue); below, diffuse colours over white.",
    ]  # fmt: skip
    for cut in table["sections"]:
        shares = "; ".join(
            f"{label}: {100 * s['opaque']:.2f} % opaque, {100 * s['with_alpha']:.2f} % with alpha, "
            f"{100 * s['stored']:.1f} % in stored macroblocks"
            for label, s in cut["shares"].items()
        )
        lines += ["", f"Across {cut['axis']} at {cut['at']:.3g}. {shares}."]
        lines += ["", f"![Cross-section across {cut['axis']}]({cut['picture']})"]
    return lines


SECTIONS: Mapping[str, tuple[str, Callable[[Table, Mapping[str, Any]], list[str]]]] = {
    "performance": ("Performance (table 1)", _performance),
    "quality": ("Quality: from the field to what is shown (table 2)", _quality),
    "storage": ("Storage (table 3)", _storage),
    "resolution": ("Resolution (appendix)", _resolution),
    "real": ("Real scenes (appendix)", _real),
    "sparsity": ("Sparsity loss (figure 4)", _sparsity),
}
