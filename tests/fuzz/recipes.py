"""Recipes: which valid files are spoilt how. Drawn from a seed, kept as findings, and done again.

A recipe is JSON: {"subject": "packs", "base": "avif", "steps": [["cut", "rgb_000.avif", 100]]}; see tests.fuzz.mutations. A
finding is a recipe with "found", what was wrong.
"""

import importlib
import json
from pathlib import Path
from random import Random
from typing import Any

from tests.fuzz.trees import Tree, read_tree
from tools.fuzz.proposals import propose

SUBJECTS = ("packs", "scenes", "settings", "runs")
FINDINGS = Path(__file__).parent / "findings.jsonl"
ARCHIVED = 0.35  # of packs

Recipe = dict[str, Any]


def write_bases(folder: Path, subjects: tuple[str, ...] = SUBJECTS) -> Path:
    """The valid files of each subject, in folders of their own; `folder`."""
    for subject in subjects:
        module: Any = importlib.import_module(f"tests.fuzz.{subject}")
        for base in module.BASES:
            if not (folder / subject / base).is_dir():
                (folder / subject).mkdir(parents=True, exist_ok=True)
                module.write_base(base, folder / subject / base)
    return folder


class Source:
    """Recipes of one subject by number; the same for the same seed and number."""

    def __init__(self, subject: str, bases: Path, seed: int) -> None:
        self.subject, self.seed = subject, seed
        self.trees: dict[str, Tree] = {base.name: read_tree(base) for base in sorted((bases / subject).iterdir())}

    def recipe(self, number: int) -> Recipe:
        random = Random(f"{self.seed} {self.subject} {number}")
        base = random.choice(list(self.trees))
        archived = self.subject == "packs" and random.random() < ARCHIVED
        return {"subject": self.subject, "base": base, "steps": propose(random, self.trees[base], archived)}


def findings() -> list[Recipe]:
    return [json.loads(line) for line in FINDINGS.read_text(encoding="utf-8").splitlines()]
