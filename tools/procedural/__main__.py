"""`python -m tools.procedural OUT`: writes a procedural scene."""

import sys
from pathlib import Path

import tyro

from console import run_command
from tools.procedural import Arrangement, write_procedural_scene


def procedural(
    out: tyro.conf.Positional[Path],
    scene: Arrangement = "still-life",
    size: int = 200,
    views: int = 60,
    seed: int = 0,
    subpixels: int = 3,
) -> None:
    """Writes a procedural scene in Blender layout.

    Args:
        out: Folder to write.
        scene: What there is: still-life, glass (mirrors, tinted glass behind tinted glass), wires (a cage, a net and strings as
            thin as a pixel), or island (with a lighthouse: the bundled demo; ten times as slow).
        size: Width and height of the photographs, in pixels.
        views: Number of training views. A sixth as many test views are added.
        seed: Random seed of colours and positions.
        subpixels: Rays per pixel, along each side.
    """
    write_procedural_scene(out, arrangement=scene, size=size, views=views, seed=seed, subpixels=subpixels)


if __name__ == "__main__":
    sys.exit(run_command(procedural, prog="python -m tools.procedural"))
