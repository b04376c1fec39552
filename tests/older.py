"""Files that an older version wrote (tests/data/older), for tests of these and for tests that need a run, trained or not here."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

OLDER = Path(__file__).parent / "data" / "older"
SCENE = OLDER / "scene"


def older_run(method: str, folder: Path) -> Path:
    """A copy of the run of "nerf" or "voxels" in `folder`, which says where its photographs are now."""
    shutil.copytree(OLDER / method, folder)
    description = json.loads((folder / "config.json").read_text())
    description["scene"] = str(SCENE)
    (folder / "config.json").write_text(json.dumps(description))
    return folder
