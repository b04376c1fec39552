"""Masks beside bare photographs: white where the object is. Features are found there alone, and the scene brings them along."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from training.scenes.pictures import as_bytes, read_mask
from training.scenes.sources import MASKS


def put_mask(mask: Path, photograph: Path, folder: Path, name: str) -> np.ndarray:
    """Writes a mask as `folder` / `name`.png, as COLMAP calls its own, and returns its values uint8 [H, W].

    UserError where it cannot be read or does not fit.
    """
    values = as_bytes(read_mask(mask, photograph))
    folder.mkdir(exist_ok=True)
    Image.fromarray(values).save(folder / f"{name}.png", format="PNG", compress_level=3)
    return values


def masked_names(work: Path) -> list[str]:
    """Names of the prepared pictures that have a mask, sorted."""
    return sorted(file.name.removesuffix(".png") for file in (work / MASKS).glob("*.png"))
