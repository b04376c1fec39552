"""`python -m tools.spoilt PHOTOS OUT`: versions of a capture that anybody would call worse, for `snerg-make --check`.

OUT/whole: the first photographs, shrunk. OUT/blurred, OUT/third (every third alone) and OUT/exposure (in turns darker and
brighter): what becomes of them.
"""

from __future__ import annotations

import sys
from pathlib import Path

import tyro
from PIL import Image, ImageFilter

from console import run_command
from training.scenes.files import visible_files
from training.scenes.picture_headers import FORMATS

EXPOSURES = (1.0, 0.6, 1.5, 0.8)
BLUR = 2.5  # pixels, standard deviation


def spoilt(
    photos: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path], count: int = 16, longest_side: int = 640
) -> None:
    """Writes spoilt versions of a capture.

    Args:
        photos: Folder of photographs.
        out: Folder for a folder of each version.
        count: Number of photographs, from the first on.
        longest_side: In pixels; larger ones are shrunk.
    """
    for i, file in enumerate(visible_files(photos)[:count]):
        picture = Image.open(file, formats=FORMATS).convert("RGB")
        picture.thumbnail((longest_side, longest_side))
        versions = {"whole": picture, "blurred": picture.filter(ImageFilter.GaussianBlur(BLUR))}
        versions["exposure"] = picture.point([min(int(value * EXPOSURES[i % 4]), 255) for value in range(256)] * 3)
        if i % 3 == 0:
            versions["third"] = picture
        for name, version in versions.items():
            (out / name).mkdir(parents=True, exist_ok=True)
            version.save(out / name / f"{i:03d}.jpg", quality=92)


if __name__ == "__main__":
    sys.exit(run_command(spoilt, prog="python -m tools.spoilt"))
