"""A report as Markdown: what the other modules here measured, for people to read, beside what the paper and the release print."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from baker.reports import paper_figures
from baker.reports.scenes import COLUMNS
from console.progress import duration

Table = Mapping[str, Any]
Row = Mapping[str, Any]
NONE = "–"
FIGURES_NAME = "figures"  # of a table: the pictures beside it
SCORES = ("PSNR (dB)", "SSIM", "LPIPS")
THEIRS = ("*paper:* PSNR", "*SSIM*", "*LPIPS*")
NO_SUCH_FIELD = "It shares the head and the sparsity term of the paper's deferred NeRF, but is not that field."


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
        made = document["tables"].get(f"{table} {key}")
        if made is None:
            continue
        scenes, cells = made["scenes"], []
        for row in made["rows"]:
            values = [row["mean"], *(row["values"][scene] for scene in scenes)]
            cells.append([row["label"], *(_number(value, digits, unit) for value in values)])
            if any(value is not None for value in row["paper"].values()):
                values = [row["paper_mean"], *(row["paper"][scene] for scene in scenes)]
                cells.append(
                    [f"*{row['label']}, the paper*", *(_italic(_number(value, digits, unit)) for value in values)]
                )
        lines += ["", f"{heading} {title}", "", *_table(["", "mean", *scenes], cells)]
    return lines


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(headings)} |", "| --- |" + " ---: |" * (len(headings) - 1)]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows)]


def _number(value: float | None, digits: int, unit: float = 1.0) -> str:
    return NONE if value is None else f"{value / unit:,.{digits}f}"


def _italic(text: str) -> str:
    return text if text == NONE else f"*{text}*"


def _scores(row: Row) -> list[str]:
    return [_number(row.get(key), digits) for key, digits in (("psnr", 2), ("ssim", 4), ("lpips", 4))]


def _theirs(row: Row, *columns: tuple[str, int]) -> list[str]:
    paper = row.get("paper") or {}
    return [_italic(_number(paper.get(key), digits)) for key, digits in columns]


PRINTED = (("psnr", 2), ("ssim", 3), ("lpips", 3))
PRINTED_SPEED = (("ms", 1, 1.0), ("fps", 1, 1.0), ("gpu_gb", 0, 1e-3))  # the last in MB


def _release(row: Row) -> str:
    return _italic(_number((row.get("release") or {}).get("psnr"), 2))


def _to_fill(rows: Iterable[Row]) -> list[str]:
    """Below a table: the command for each row without a run."""
    lines = []
    for row in rows:
        if command := row.get(
            "command"
        ):  # see baker.reports.fields.train_command: what follows "; then add" is an option
            lines.append(f"- {row['label']}: `{'`, then add `'.join(command.split('; then add '))}`")
    return ["", "Rows without a run, and what would make them:", "", *lines] if lines else []


def _quality(table: Table, about: Mapping[str, Any]) -> list[str]:
    rows = table["rows"]
    field = next((row["psnr"] for row in rows if row["row"] == "field"), None)
    if field is None:
        field = next((row["psnr"] for row in rows if row["row"] == "deferred" and "psnr" in row), None)
    cells = []
    for row in rows:
        gap = NONE if field is None or "psnr" not in row else f"{row['psnr'] - field:+.2f}"
        took = NONE if row.get("seconds") is None else duration(row["seconds"])
        cells.append([
            row["label"], *_scores(row), gap, _number(row.get("bytes"), 2, 1e6), took, *_theirs(row, *PRINTED), _release(row),
        ])  # fmt: skip
    headings = ["", *SCORES, "against the field (dB)", "MB", "time", *THEIRS, "*release:* PSNR"]
    own = NO_SUCH_FIELD if table["field"].startswith(("multi-resolution field", "voxel field")) else ""
    means = [
        str(row["label"]).split(":")[0] for row in rows if row.get("paper") and paper_figures.only_means(row["row"])
    ]
    lines = [
        f"Packs of {table['resolution']} voxels along the longest side, baked from: {table['field']}. {own}".strip(), "",
        *_table(headings, cells), "",
        "SNeRG rows are baked as the paper writes (`snerg-bake --preset paper`), ours by default settings. Time is of training "
        "for fields, of baking for packs."
        + (f" The paper prints {', '.join(means)} as means over its synthetic scenes only." if means else ""),
        *_to_fill(rows),
    ]  # fmt: skip
    for name, figure in table.get(FIGURES_NAME, {}).items():
        lines += ["", f"![{name}: {figure['view']}]({figure['picture']})", ""]
        lines.append(
            f"View {figure['view']}, and a crop of it where the first and the last picture differ most. PSNR of the whole view "
            "in brackets."
        )
    return lines


def _storage(table: Table, about: Mapping[str, Any]) -> list[str]:
    headings = ["", "quality", "MB", "of PNG", *SCORES, "PSNR against the pack (dB)", "encode (s)", "decode (s)"]
    headings += ["*paper:* MB", "*PSNR*", "*SSIM*", "*LPIPS*"]
    rows, png = table["rows"], next(row["bytes"] for row in table["rows"] if row["row"] == "png")
    cells = []
    for row in rows:
        quality = "" if "codec" not in row else "lossless" if row["quality"] is None else f"{row['quality']}"
        quality += " (default)" if row.get("default") and row.get("quality") is not None else ""
        against = row.get("psnr_against_pack")
        same = NONE if against is None else "identical" if against >= 119 else f"{against:.2f}"
        share = NONE if row.get("bytes") is None else f"{100 * row['bytes'] / png:.0f} %"
        cells.append([
            row["label"], quality or NONE, _number(row.get("bytes"), 2, 1e6), share, *_scores(row), same,
            _number(row.get("encode_s"), 1), _number(row.get("decode_s"), 1), *_theirs(row, ("mb", 1), *PRINTED),
        ])  # fmt: skip
    kind = "as the paper writes, view MLP fine-tuned" if table["preset"] == "paper" else "by our default settings"
    return [
        f"Packs of {table['resolution']} voxels along the longest side, baked {kind}; the row of floats is the paper's bake "
        "before it is quantised. Bytes of networks and floats are 4 a number. The paper prints this table as means over "
        f"{paper_figures.KINDS[about['kind']]}.",
        "", *_table(headings, cells), *_to_fill(rows), "", "![PSNR over megabytes, by codec](storage.png)",
    ]  # fmt: skip


def _device(table: Table) -> list[str]:
    orbit = "" if table["distance"] is None else f", orbit at {table['distance']:.4g} ({table['distance_from']})"
    return [
        f"Frame times: {table['renderer']}; {table['clock']}; {table['width']} x {table['height']} pixels, path "
        f"{table['protocol']}{orbit}, {table['frames']} frames, each drawn by every row in turn.",
        *(f"Note: {notice}." for notice in table["notices"]),
    ]


def _performance(table: Table, about: Mapping[str, Any]) -> list[str]:
    nominal = any("fps_per_nominal_watt" in row for row in table["rows"])
    headings = ["", "ms a frame", "p50 (ms)", "FPS", "FPS/W", *(["FPS/W, nominal"] if nominal else []), "GPU MB"]
    headings += ["*paper:* ms a frame", "*FPS*", "*GPU MB*"]
    cells = []
    for row in table["rows"]:
        took = NONE if row.get("ms_mean") is None else f"{row['ms_mean']:.2f} ± {row['ms_std']:.2f}"
        paper = dict(row.get("paper") or {})
        theirs = [_italic(_number(paper.get(key), digits, unit)) for key, digits, unit in PRINTED_SPEED]
        cells.append([
            row["label"], took, _number(row.get("ms_p50"), 2), _number(row.get("fps"), 1), _number(row.get("fps_per_watt"), 3),
            *([_number(row.get("fps_per_nominal_watt"), 5)] if nominal else []), _number(row.get("gpu_bytes"), 1, 1e6), *theirs,
        ])  # fmt: skip
    lines = [
        f"Packs of {table['resolution']} voxels along the longest side. ± is over frames. The paper measured its whole system "
        "(its bake and its marcher) on a laptop with an 85 W AMD Radeon Pro 5500M.",
        "", *_table(headings, cells), "", *_device(table), *_to_fill(table["rows"]),
    ]  # fmt: skip
    speed = paper_figures.SPEED[about["kind"]]
    if speed:
        lines += [
            "",
            f"What the paper prints of itself and of others, of {paper_figures.KINDS[about['kind']]} (not measured here):",
            "",
        ]
        quality = paper_figures.QUALITY[about["kind"]]
        rows = [
            [f"*{paper_figures.NAMES.get(name, name)}*", *(_italic(_number(quality[m][name][0], d)) for m, d in PRINTED),
             f"*{watts:g}*", f"*{fps:g}*", f"*{each:.5f}*"]
            for name, (watts, fps, each) in speed.items()
        ]  # fmt: skip
        lines += _table(["*method*", "*PSNR*", "*SSIM*", "*LPIPS*", "*W*", "*FPS*", "*FPS/W*"], rows)
    return lines


def _resolution(table: Table, about: Mapping[str, Any]) -> list[str]:
    headings = ["voxels", *SCORES, "MB", "macroblocks", "GPU MB", "p50 of exact (ms)", "FPS", "bake"]
    headings += [*THEIRS, "*FPS*", "*MB*"]
    cells = [
        [row["label"], *_scores(row), _number(row.get("bytes"), 2, 1e6), _number(row.get("macroblocks"), 0),
         _number(row.get("gpu_bytes"), 1, 1e6), _number(row.get("ms_p50"), 1), _number(row.get("fps"), 1),
         NONE if row.get("seconds") is None else duration(row["seconds"]), *_theirs(row, *PRINTED, ("fps", 2), ("mb", 1))]
        for row in table["rows"]
    ]  # fmt: skip
    kind = "as the paper writes" if table["preset"] == "paper" else "by our default settings"
    return [
        f"Baked {kind}. The paper prints this table as means over its synthetic scenes, with the sparsity loss.",
        "", *_table(headings, cells), "", *_device(table), *_to_fill(table["rows"]), "",
        "![Quality, size and frame time over the resolution](resolution.png)",
    ]  # fmt: skip


def _real(table: Table, about: Mapping[str, Any]) -> list[str]:
    headings = ["", *SCORES, "masked: PSNR", "SSIM", "LPIPS", *THEIRS, "*release:* PSNR"]
    cells = [
        [row["label"], *_scores(row), *_scores(row.get("masked") or {}), *_theirs(row, *PRINTED), _release(row)]
        for row in table["rows"]
    ]
    masked = "masked" if table["paper_is_masked"] else "of whole pictures"
    return [
        f"Packs of {table['resolution']} voxels along the longest side, baked from: {table['field']}. Masked: photographs and "
        "pictures of all rows are compared where the paper's bake is opaque, as the paper does for 360° scenes. Its own "
        f"figures here are {masked}.",
        "", *_table(headings, cells), *_to_fill(table["rows"]),
    ]  # fmt: skip


def _sparsity(table: Table, about: Mapping[str, Any]) -> list[str]:
    headings = ["run", "lambda", *SCORES, "MB", "macroblocks", "voxels with alpha"]
    cells = []
    for row in table["rows"]:
        if "psnr" not in row:
            cells.append([row["label"], *[NONE] * 7])
            continue
        blocks, voxels = row["macroblocks"], row["voxels"]
        hidden = ", hidden macroblocks kept" if row["row"] == "hidden" else ""
        cells.append([
            f"{row['run']}: {row['field']}{hidden}", f"{row['sparsity_weight']:g}", *_scores(row), _number(row["bytes"], 2, 1e6),
            f"{blocks['occupied']} of {blocks['grid']}", f"{voxels['with_alpha']} of {voxels['grid']}",
        ])  # fmt: skip
    lines = [
        f"Baked at {table['resolution']} voxels as the paper writes: our own bake empties voxels that no photograph shows, and "
        "with them the fog that a field trained without the loss leaves.",
        "", *_table(headings, cells), *_to_fill(table["rows"]), "", "![Opacity of stored voxels](sparsity.png)", "",
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
