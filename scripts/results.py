"""`make results`: writes docs/results.md from docs/results/page.md and the figures in docs/results/*.json beside it, and a page
for each scene's report, docs/results/reports/SCENE.md.

No figure is typed into the page. page.md names them:

    {{codecs.webp_less}}            figures["webp_less"] of docs/results/codecs.json
    {{tests.tests:,.0f}}            the same, written in this format of Python's
    {{codecs.device}}               another text of that file: of, commit, device
    {{codecs.commands}}             its command lines, as a block of code (a line of its own, as are the next two)
    {{codecs.table:demo}}           tables["demo"] as a Markdown table; bold lists cells as [row, column]
    {{reports}}                     docs/results/reports/*.json, each the report.json of a snerg-report, side by side

`python scripts/results.py --check` exits with status 1 where a page is not what it would write.
"""

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from baker.reports.pages import SECTIONS, scenes_document, scenes_tables, sections  # noqa: E402

DOCS = ROOT / "docs"
MARK = re.compile(r"\{\{([\w-]+)(?:\.(\w+))?(?::([^}]+))?\}\}")
NO_REPORTS = (
    "These tables have not been measured at full size yet. The figures on this page come from the single commands."
)


def page(docs: Path = DOCS) -> str:
    """The text of docs/results.md. KeyError where page.md names what no file holds."""
    figures = {
        path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted((docs / "results").glob("*.json"))
    }
    template = (docs / "results/page.md").read_text(encoding="utf-8")

    def fill(mark: re.Match[str]) -> str:
        name, key, how = mark.groups()
        if name == "reports":
            return reports_text(docs / "results/reports")
        file = figures[name]
        if key == "table":
            return table_text(file["tables"][how])
        if key in file["figures"]:
            value = file["figures"][key]
            return str(value) if how is None else format(value, how)
        value = file[key]
        return "\n".join(f"    {line}".rstrip() for line in value) if isinstance(value, list) else str(value)

    return MARK.sub(fill, template)


def table_text(table: Mapping[str, Any]) -> str:
    columns, formats = table["columns"], table["formats"]
    bold = {tuple(place) for place in table.get("bold", ())}
    lines = [_line(columns), _line(["---"] * len(columns))]
    for r, row in enumerate(table["rows"]):
        cells = []
        for c, (value, how) in enumerate(zip(row, formats, strict=True)):
            text = "" if value is None else str(value) if how is None else format(value, how).replace("-", "−")
            cells.append(f"**{text}**" if (r, c) in bold else text)
        lines.append(_line(cells))
    return "\n".join(lines)


def _line(cells: list[str]) -> str:
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|"


def reports_text(folder: Path) -> str:
    """All reports in a folder: what each is about, with a link to its page, and their tables side by side."""
    reports = read_reports(folder)
    if not reports:
        return NO_REPORTS
    lines = ["| scene | field | packs | photographs | its tables |", "| --- | --- | --- | --- | --- |"]
    for stem, document in reports.items():
        about = document["about"]
        quality = document["tables"].get("quality", {})
        field, packs = quality.get("field", f"{about['step']:,} steps"), quality.get("resolution")
        link = f"[{', '.join(name for name in SECTIONS if name in document['tables'])}](results/reports/{stem}.md)"
        size = f"{about['views']} of {about['width']} × {about['height']}"
        lines.append(_line([about["name"], field, f"{packs}³" if packs else "–", size, link]))
    together = scenes_document(list(reports.values()))
    together["tables"] = {name: table for name, table in together["tables"].items() if len(table["scenes"]) > 1}
    if together["tables"]:
        lines += ["", *scenes_tables(together, "###")]
    return "\n".join(lines)


def read_reports(folder: Path) -> dict[str, dict[str, Any]]:
    """The reports in a folder by the stem of their file, without a machine's folders."""
    return {
        file.stem: without_folders(json.loads(file.read_text(encoding="utf-8")))
        for file in sorted(folder.glob("*.json"))
    }


def report_page(document: Mapping[str, Any]) -> str:
    """The tables of one scene; without their pictures, which are not kept here."""
    about = document["about"]
    lines = [
        f"# The paper's tables: {about['name']}",
        "",
        f"{about['step']:,} steps; means of {about['views']} {about['split']} photographs of {about['width']} × "
        f"{about['height']}. Columns in *italics* are not ours: they are the paper's and its release's own figures, of "
        f"{about['theirs']}, measured on their machines. [All scenes](../../results.md#the-papers-tables)",
    ]
    for name, title, section in sections(document, figures=False):
        lines += ["", f"## {title}"]
        if made := document.get("made", {}).get(name):
            lines += ["", f"    {made['command']}", "", f"Commit {made['commit']}; {made['device']}."]
        text = "\n".join(line for line in section if not line.startswith("!["))
        lines += ["", re.sub(r"\n{3,}", "\n\n", text).rstrip("\n")]
    return "\n".join(lines) + "\n"


def without_folders(document: Mapping[str, Any]) -> dict[str, Any]:
    """A report with DIR, RUN and SCENE in place of a machine's folders."""
    about, text = document["about"], json.dumps(document)
    for path, word in sorted(((about["out"], "DIR"), (about["run"], "RUN"), (about["scene"], "SCENE")), reverse=True):
        text = text.replace(json.dumps(path)[1:-1], word)
    return json.loads(text)


def pages() -> dict[Path, str]:
    """Every page that is written, and its text."""
    reports = DOCS / "results/reports"
    scenes = {reports / f"{stem}.md": report_page(document) for stem, document in read_reports(reports).items()}
    return {DOCS / "results.md": page(), **scenes}


def main(words: list[str]) -> int:
    """Writes the pages, and the reports without a machine's folders; or says whether the pages are as they would be written."""
    texts = pages()
    if "--check" in words:
        stale = [path for path, text in texts.items() if not path.is_file() or path.read_text(encoding="utf-8") != text]
        for path in stale:
            print(f"{path} is not what its figures give: make results", file=sys.stderr)
        return 1 if stale else 0
    for stem, document in read_reports(DOCS / "results/reports").items():
        text = json.dumps(document, indent=2) + "\n"
        (DOCS / f"results/reports/{stem}.json").write_text(text, encoding="utf-8")
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
