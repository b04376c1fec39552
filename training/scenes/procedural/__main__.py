"""`python -m training.scenes.procedural OUT`: writes the procedural scene."""

from __future__ import annotations

import sys
from pathlib import Path

import tyro

from console import run_command
from training.scenes.procedural import write_procedural_scene


def procedural(out: tyro.conf.Positional[Path], size: int = 200, views: int = 60, seed: int = 0) -> None:
    """Writes the procedural scene in Blender layout.

    Args:
        out: Folder to write.
        size: Pixels a side.
        views: Training views; a sixth as many test views are added.
        seed: Hues and places; 0 is the bundled demo.
    """
    write_procedural_scene(out, size=size, views=views, seed=seed)


if __name__ == "__main__":
    sys.exit(run_command(procedural, prog="python -m training.scenes.procedural"))
