"""Fuzzes for as long as one likes: `python -m tools.fuzz --minutes 10 --seed 3 --only packs`.

What breaks is made smaller and kept in tests/fuzz/findings.jsonl, one for each cause; the exit status is then 1. The same seed
draws the same files.
"""

import argparse
import itertools
import json
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from baker.reports.pages import markdown_table
from tests.fuzz.child import FINDING, OPENED, REFUSED, Outcome
from tests.fuzz.recipes import FINDINGS, SUBJECTS, Recipe, Source, write_bases
from tests.fuzz.workers import Worker


class Campaign:
    """counts: by class and kind of outcome. causes: how often each was found."""

    def __init__(
        self, bases: Path, subjects: tuple[str, ...], seed: int, until: float, most: int | None, kept: bool
    ) -> None:
        self.bases, self.until, self.kept = bases, until, kept
        self.sources = [Source(subject, bases, seed) for subject in subjects]
        self.counts: Counter[tuple[str, str]] = Counter()
        self.causes: Counter[str] = Counter()
        self._lock = threading.Lock()
        numbers = itertools.count if most is None else lambda: iter(range(most))
        self._rest = {source.subject: numbers() for source in self.sources}

    def work(self) -> None:
        """Goes on until the time or the recipes are used up; any number of threads may."""
        for source in self.sources:
            left = len(self.sources) - self.sources.index(source)
            share = time.monotonic() + (self.until - time.monotonic()) / left
            with Worker(source.subject, self.bases) as worker:
                while time.monotonic() < share:
                    with self._lock:
                        number = next(self._rest[source.subject], None)
                    if number is None:
                        break
                    self._try(worker, source.recipe(number), number)

    def _try(self, worker: Worker, recipe: Recipe, number: int) -> None:
        outcome = worker.outcome(recipe)
        if outcome.kind == FINDING:
            again = worker.outcome(recipe)
            if again.key != outcome.key:
                outcome = again if again.kind == FINDING else Outcome(FINDING, f"once: {outcome.key}", outcome.line)
        with self._lock:
            self.counts[class_of(recipe), outcome.kind] += 1
            has_no_place = outcome.key.startswith(("hang", "death"))  # which do not say where
            cause = f"{outcome.key}, {class_of(recipe)}" if has_no_place else outcome.key
            new = outcome.kind == FINDING and cause not in self.causes
            self.causes[cause] += outcome.kind == FINDING
        if new:
            recipe = smaller(recipe, lambda fewer: worker.outcome(fewer).key == outcome.key)
            if self.kept:
                with open(FINDINGS, "a", encoding="utf-8") as file:
                    file.write(json.dumps({**recipe, "found": f"{outcome.key}: {outcome.line}"[:300]}) + "\n")
            print(f"{recipe['subject']} {number}: {outcome.key}: {outcome.line}\n    {recipe}", flush=True)

    def table(self) -> str:
        """Counts by class, as a table in Markdown."""
        rows = []
        names = sorted({name for name, _ in self.counts})
        for name in [*names, "all"]:
            by_kind = [
                sum(n for (c, k), n in self.counts.items() if k == kind and name in (c, "all"))
                for kind in (OPENED, REFUSED, FINDING)
            ]
            rows.append((name, *(f"{n:,}" for n in (sum(by_kind), *by_kind))))
        return markdown_table(("class", "files", "opened", "refused", "findings"), rows)


def class_of(recipe: Recipe) -> str:
    """What a recipe is counted under: "packs, avif, .zip"."""
    archived = any(step[1] == "@zip" for step in recipe["steps"])
    return ", ".join([recipe["subject"], recipe["base"], *([".zip"] if archived else [])])


def smaller(recipe: Recipe, same: Callable[[Recipe], bool]) -> Recipe:
    """The recipe without the steps that do not matter to `same`."""
    for index in reversed(range(len(recipe["steps"]))):
        fewer = {**recipe, "steps": recipe["steps"][:index] + recipe["steps"][index + 1 :]}
        if fewer["steps"] and same(fewer):
            recipe = fewer
    return recipe


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="how long (default 10)")
    parser.add_argument("--count", type=int, help="so many files of each kind at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--only", choices=SUBJECTS, action="append", help="one kind of files; may be given several times"
    )
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--no-keep", action="store_true", help="print findings, but keep none")
    given = parser.parse_args()
    subjects = tuple(given.only or SUBJECTS)
    with tempfile.TemporaryDirectory(prefix="snerg-fuzz-") as folder:
        bases = write_bases(Path(folder), subjects)
        until = time.monotonic() + 60 * given.minutes
        campaign = Campaign(bases, subjects, given.seed, until, given.count, not given.no_keep)
        threads = [threading.Thread(target=campaign.work) for _ in range(given.workers)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    print(campaign.table())
    for cause, times in campaign.causes.most_common():
        if times:
            print(f"{times:6} {cause}")
    return 1 if +campaign.causes else 0


if __name__ == "__main__":
    sys.exit(main())
