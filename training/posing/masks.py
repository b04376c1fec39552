"""Masks beside bare photographs: white where the object is. Features are found there alone, and the scene brings them along."""

from __future__ import annotations

from pathlib import Path

from PIL import ImageOps

from console import UserError
from training.posing.camera_files import Look
from training.scenes.pictures import UNREADABLE, decodable, times
from training.scenes.sources import MASKS

BLACK = 8  # of 255: JPEG leaves no black as it was


def put_mask(mask: Path, photograph: Path, look: Look, folder: Path, name: str) -> None:
    """Writes a mask as `folder` / `name`.png, as COLMAP calls its own. UserError where it cannot be read or does not fit."""
    try:
        with decodable(mask) as image:
            picture = ImageOps.exif_transpose(image).convert("RGB").getchannel(0)
    except UNREADABLE as error:
        raise UserError("the mask cannot be decoded", where=mask, found=str(error).split("\n")[0][:120]) from error
    if picture.size != look.size and picture.size[::-1] == look.size and look.turned is not None:
        picture = picture.transpose(look.turned)  # drawn on the picture as it is stored
    if picture.size != look.size:
        raise UserError("the mask is of another size than its photograph", where=mask, expected=times(look.size),
                        found=times(picture.size), remedy=f"make it as large as {photograph.name}")  # fmt: skip
    folder.mkdir(exist_ok=True)
    picture.point([0] * BLACK + list(range(BLACK, 256))).save(folder / f"{name}.png", format="PNG", compress_level=3)


def masked_names(work: Path) -> list[str]:
    """Names of the prepared pictures that have a mask, sorted."""
    return sorted(file.name.removesuffix(".png") for file in (work / MASKS).glob("*.png"))
