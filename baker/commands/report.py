"""`snerg-report RUN --out DIR`: the SNeRG paper's tables of one run (section 7 and appendix), measured; and of several scenes.

Writes DIR/report.md, report.json, plots, crops and cross-sections. Packs are baked into DIR/packs, scores and scored pictures
lie in DIR/scores and DIR/pictures. Typed again, the line goes on: what is there is kept, and so are tables that are not asked
for this time. Given the folders of several reports instead of a run, it puts their scenes side by side, with their mean.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from baker.reports.options import ReportOptions
from console import UserError, check_results, run_command, write_json, write_result
from training.libraries import begin_libraries


def snerg_report(
    subjects: tuple[Path, ...], /, options: Annotated[ReportOptions, tyro.conf.arg(name="")]
) -> None:  # fmt: skip
    """Measures the SNeRG paper's tables on a trained run, or puts the reports of several scenes side by side.

    Args:
        subjects: Folder of a run, from snerg-train; or folders of several earlier reports, to put their scenes side by side.
        options: What to measure, and of what.
    """
    options.check()
    out = options.out
    check_results(folder=out)
    if (run := next(iter(subjects), None)) is None:
        raise UserError("needs a run, or the reports of several scenes", where="snerg-report")
    if len(subjects) > 1 or (run / "report.json").is_file():
        _side_by_side(subjects, out)
        return
    begin_libraries()  # JAX starts here, not for --help
    from baker.reports.report import open_study, write_tables

    study = open_study(run, options)
    write_tables(study, options.tables_of(study.kind))


def _side_by_side(folders: Sequence[Path], out: Path) -> None:
    from baker.reports.pages import read_report, scenes_document, scenes_text

    if any(folder.resolve() == out.resolve() for folder in folders):
        raise UserError("is one of the reports", where=f"--out {out}", expected="a folder of its own")
    document = scenes_document([read_report(folder) for folder in folders])
    write_json(out / "report.json", document)
    write_result(out / "report.md", scenes_text(document))
    print(f"{len(folders)} scenes: in {out / 'report.md'}")


def main(args: Sequence[str] | None = None) -> int:
    return run_command(snerg_report, prog="snerg-report", args=args)
