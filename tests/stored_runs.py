"""Runs that are kept (tests/data/runs), for tests that need a run but no training."""

from pathlib import Path

STORED = Path(__file__).parent / "data" / "runs"
SCENE = STORED / "scene"  # the photographs of these runs, which say that they lie elsewhere
