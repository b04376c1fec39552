"""A report in parts: one that fails, or finds no time any more, leaves the others alone.

report.json is written anew behind each part, so that whatever ends the program leaves what was measured before.
"""

import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from console import write_json

Facts = dict[str, Any]


class Skipped(Exception):
    """A part that cannot be done here, which is no failure; the message says why."""


class Budget:
    """The time that is left of `minutes`."""

    def __init__(self, minutes: float) -> None:
        self._end = time.monotonic() + 60.0 * minutes

    @property
    def left(self) -> float:
        """Seconds; 0 where none are left."""
        return max(self._end - time.monotonic(), 0.0)


@dataclass(frozen=True)
class Part:
    """work: gets the budget and returns facts; "problems" among them, a list of lines, says what is wrong with them.

    least: seconds that must be left for it to begin.
    """

    name: str
    work: Callable[[Budget], Facts]
    least: float = 0.0


def run_parts(parts: Sequence[Part], out: Path, minutes: float) -> Facts:
    """Does the parts in turn; {"parts": {name: {"status", "why", "seconds", facts}}}, also as out/report.json.

    status: done, skipped or failed. why: "" where it is done.
    """
    budget, report = Budget(minutes), {"parts": {}}
    for number, part in enumerate(parts, 1):
        print(f"{number} of {len(parts)}: {part.name}", file=sys.stderr, flush=True)
        began = time.monotonic()
        outcome = _outcome(part, budget)
        report["parts"][part.name] = {**outcome, "seconds": round(time.monotonic() - began, 1)}
        if outcome["status"] != "done":
            print(f"  {outcome['status']}: {outcome['why']}", file=sys.stderr, flush=True)
        write_json(out / "report.json", report)
    return report


def _outcome(part: Part, budget: Budget) -> Facts:
    if budget.left < part.least or not budget.left:
        return {
            "status": "skipped",
            "why": f"no time is left: it needs {part.least:.0f} s, there are {budget.left:.0f}",
        }
    try:
        facts = part.work(budget)
    except Skipped as reason:
        return {"status": "skipped", "why": str(reason)}
    except Exception as error:  # the next parts may still succeed, and the card may be at hand only once
        return {"status": "failed", "why": str(error) or type(error).__name__, "traceback": traceback.format_exc()}
    problems = facts.pop("problems", [])
    return {"status": "failed" if problems else "done", "why": "; ".join(problems), **facts}
