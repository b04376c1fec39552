"""Files that an older version wrote (tests/data/older): for tests of these, and for tests that need a run but no training."""

from __future__ import annotations

from pathlib import Path

OLDER = Path(__file__).parent / "data" / "older"
SCENE = OLDER / "scene"  # the photographs of its runs, which say that they lie elsewhere
