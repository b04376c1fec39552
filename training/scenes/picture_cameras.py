"""Fitting a described camera to the picture on disk: smaller ones, and ones that EXIF turns."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from console import Notice, UserError
from training.scenes.files import few
from training.scenes.pictures import PictureLoader, is_turned, picture_size, times
from training.scenes.scene import Camera, Photograph

SHAPE_TOLERANCE = 0.01  # how far width over height may differ, as a share; or by a pixel, as shrunk sizes are rounded


def camera_of_picture(
    picture: Path, camera_for: Callable[[tuple[int, int]], Camera], shape: tuple[int, int] | None = None
) -> tuple[Camera, tuple[int, int], bool]:
    """The camera for a picture as it is read, its size (width, height), and whether EXIF's orientation is passed over.

    camera_for: the described camera, given the size of the picture. shape: a size whose shape the picture must have, too.
    Pictures are turned as EXIF says, unless the camera fits them only as they are stored. UserError where it fits neither.
    """
    upright = picture_size(picture)
    sizes = [upright] + ([picture_size(picture, as_stored=True)] if is_turned(picture) else [])
    for as_stored, size in enumerate(sizes):
        camera = camera_for(size)
        if _same_shape(size, (camera.width, camera.height)) and (shape is None or _same_shape(size, shape)):
            return camera.resized(*size), size, bool(as_stored)
    camera = camera_for(upright)
    expected = (camera.width, camera.height) if not _same_shape(upright, (camera.width, camera.height)) else shape
    raise UserError("the picture is of another size", where=picture, expected=f"the shape of {times(expected or upright)}",
                    found=times(upright))  # fmt: skip


def tell_turned(where: Path, photographs: Sequence[Photograph]) -> None:
    """A Notice of pictures that EXIF turns: which are turned, and which are taken as they are stored."""
    loaders = [
        (photograph.name, photograph.load) for photograph in photographs if isinstance(photograph.load, PictureLoader)
    ]
    told = {
        "are turned as EXIF says": [name for name, load in loaders if not load.as_stored and is_turned(load.path)],
        "are not turned as EXIF says: their cameras fit otherwise": [name for name, load in loaders if load.as_stored],
    }
    for what, names in told.items():
        if names:
            text = f"{len(names)} of {len(photographs)} pictures {what} ({few(names)})"
            warnings.warn(Notice(f"{where}: {text}"), stacklevel=3)


def _same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    (w, h), (width, height) = size, other
    return abs(w * height - h * width) <= max(SHAPE_TOLERANCE * h * width, width, height)
