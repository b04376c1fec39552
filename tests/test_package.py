"""The distribution's metadata."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import metadata
from pathlib import Path

from viewer.features.making.survey import PARTS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]


def test_extras_of_jax_are_called_as_jax_calls_them() -> None:
    there = metadata("jax").get_all("Provides-Extra")
    asked = {name for extra in EXTRAS.values() for entry in extra for name in re.findall(r"^jax\[(\w+)\]", entry)}
    assert asked == {"cuda12", "cuda13"} and there is not None and asked <= set(there)


def test_what_the_viewer_looks_for_is_what_the_extra_train_brings() -> None:
    brought = {re.split(r"[>=\[]", entry)[0] for entry in [*EXTRAS["train"], *PROJECT["dependencies"]]}
    assert set(PARTS) <= brought
    assert {re.split(r"[>=\[]", entry)[0] for entry in EXTRAS["train"]} <= set(PARTS)
