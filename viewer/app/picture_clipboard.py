"""The picture on the system's clipboard, by copykitten: GLFW knows text only."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from console import UserError

REMEDY = "save it with Ctrl+S instead"
LARGEST_BYTES = 15 << 20  # of a PNG: X11 hands over what fits into one request


def copy_picture(picture: np.ndarray) -> None:
    """Puts a picture, uint8 [h, w, 3], on the clipboard until the program ends. UserError where that is impossible."""
    import copykitten

    if picture.nbytes > LARGEST_BYTES and _png_bytes(picture) > LARGEST_BYTES:
        raise UserError("the picture is too large for the clipboard", remedy=REMEDY)
    height, width = picture.shape[:2]
    try:
        copykitten.copy_image(Image.fromarray(picture).convert("RGBA").tobytes(), width, height)
    except copykitten.CopykittenError as error:
        raise UserError("the clipboard cannot be reached", found=str(error), remedy=REMEDY) from error


def _png_bytes(picture: np.ndarray) -> int:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG", compress_level=1)
    return file.tell()
