"""Check of photographs before a scene is made of them: `snerg-make --check` as a child process, and what it found."""

from __future__ import annotations

import webbrowser
from collections.abc import Mapping
from typing import Any

from console.json_text import read_json_file
from console.progress_protocol import Report
from viewer.core.command_process import FolderProcess
from viewer.core.tasks import Task
from viewer.features.making.make_plan import Plan

NAMED = 3  # photographs of a kind, by name
RESULT = "check.json"  # in the process's folder
GROUPS = {
    "set_aside": "set aside",
    "weakly_connected": "weakly connected",
    "differently_exposed": "differently exposed",
}


class PhotographCheck:
    """Checks a plan's photographs, from the moment this is made. Call `poll` now and then; close it in the end.

    page: what the process writes. result: what it found, as `--json` has it; None before. error: why there is none, "" where
    there is no error. report: the last progress. UserError where the process cannot be started.
    """

    def __init__(self, plan: Plan) -> None:
        self.page = plan.out / "check.html"
        self.result: Mapping[str, Any] | None = None
        self.error = ""
        self.report: Report | None = None
        self._browser: Task[bool] | None = None
        words = [str(plan.source), "--out", str(plan.out), "--check", "--json"]
        self._process: FolderProcess | None = FolderProcess.start(
            "baker.commands.make", lambda folder: [*words, str(folder / RESULT)]
        )

    @property
    def running(self) -> bool:
        """Whether there will be a result or an error."""
        return self._process is not None

    def poll(self) -> bool:
        """Whether there is something new to show."""
        process, before = self._process, self.report
        if process is None:
            return False
        status, self.report = process.child.poll(), process.child.report()
        if status is None:
            return self.report != before
        if status == 0:
            try:
                self.result = read_json_file(process.folder / RESULT)
            except (OSError, ValueError) as error:
                self.error = f"what was found cannot be read: {error}"
        else:
            self.error = process.child.error_line().removeprefix("snerg-make: ")
        self.close()
        return True

    def close(self) -> None:
        """Ends the process, if it runs, without waiting for it; the program's end does."""
        process, self._process = self._process, None
        if process is not None:
            Task(process.end, kept=True)

    def open_page(self) -> None:
        """Opens the page in the browser; `no_browser` says whether that failed."""
        self._browser = Task(lambda: webbrowser.open(self.page.resolve().as_uri()))

    def no_browser(self) -> bool:
        """Whether no browser could be started, once after open_page."""
        task = self._browser
        if task is None or not task.finished:
            return False
        self._browser = None
        return not task.result()


def result_lines(result: Mapping[str, Any]) -> list[tuple[str, bool]]:
    """What was found, a line each, and whether it is a warning."""
    count, aside = len(result["photographs"]), len(result["set_aside"])
    used = f"{count} of {count + aside} photographs are used" if aside else f"{count} photographs"
    good = f"Sharpness {result['sharpness']:.0%} and overlap {result['overlap']:.0%} of what is good"
    lines = [
        (f"{used}, {result['kind']}.", False),
        (f"{good}; exposures differ by {result['exposure_spread']:.0%}.", False),
    ]
    for group, title in GROUPS.items():
        if named := result[group]:
            lines.append((f"{len(named)} {title}: {few_with_reasons(named)}.", True))
    return lines if len(lines) > 2 else [*lines, ("None needs to be taken again.", False)]


def few_with_reasons(reasons: Mapping[str, str]) -> str:
    """Names with their reasons, the first few of them: "a.jpg (blurred), b.jpg (blurred) and 4 more"."""
    named = ", ".join(f"{name} ({why})" for name, why in list(reasons.items())[:NAMED])
    return named + (f" and {len(reasons) - NAMED} more" if len(reasons) > NAMED else "")
