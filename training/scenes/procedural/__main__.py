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
        size: Width and height of the photographs, in pixels.
        views: Number of training views. A sixth as many test views are added.
        seed: Random seed of colours and positions. 0 is the bundled demo.
    """
    write_procedural_scene(out, size=size, views=views, seed=seed)


if __name__ == "__main__":
    sys.exit(run_command(procedural, prog="python -m training.scenes.procedural"))
