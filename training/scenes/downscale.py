"""How much to shrink photographs before training, where the user leaves it to us."""

from __future__ import annotations

import warnings
from math import ceil
from pathlib import Path

from console import Notice
from training.scenes.read import load_scene


def suggested_downscale(scene: Path, longest_side: int | None) -> int:
    """The smallest whole number that brings the photographs to `longest_side` pixels or fewer; 1 where that is None.

    Asked of the reader, since it knows what a downscale counts from: the pictures of an LLFF capture may be stored shrunk.
    """
    downscale = 1
    while longest_side is not None:
        with warnings.catch_warnings():  # what the reader has to say is said when training reads the scene
            warnings.simplefilter("ignore", Notice)
            camera = load_scene(scene, downscale=downscale).splits["train"][0].camera
        longest = max(camera.width, camera.height)
        if longest <= longest_side:
            break
        downscale = max(downscale + 1, ceil(downscale * longest / longest_side))
    return downscale
