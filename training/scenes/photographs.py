"""Photographs from described cameras: fitted to the picture on disk (smaller ones, ones that EXIF turns), and moved."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from console import UserError
from training.scenes.files import notice, times
from training.scenes.picture_headers import read_header
from training.scenes.pictures import PictureLoader
from training.scenes.scene import Camera, Photograph
from training.scenes.space import Frame, poses_of

SHAPE_TOLERANCE = 0.01  # how far width over height may differ, as a share; or by a pixel, as shrunk sizes are rounded
Size = tuple[int, int]  # width, height


def photographs_of(
    where: Path, described: Iterable[tuple[str, Path, Camera, Path | None]], factor: int, downscale: int
) -> list[Photograph]:
    """Photographs of names, pictures (`factor` times smaller than full size), cameras and masks. Errors as photograph_of."""
    photographs = [photograph_of(*one, factor, downscale) for one in described]
    tell_turned(where, photographs)
    return photographs


def photograph_of(
    name: str, picture: Path, described: Camera | Callable[[Size], Camera], mask: Path | None, factor: int, downscale: int,
    shape: Size | None = None,
) -> Photograph:  # fmt: skip
    """A picture turned as EXIF says, or as it is stored where the camera fits only that. UserError where it fits neither.

    described: the camera, or the camera for a size of picture. factor: how many times smaller than full size the picture is.
    shape: a size whose shape the picture must have, too."""
    header, misfits = read_header(picture), []
    for as_stored in [False, True] if header.orientation != 1 else [False]:
        stored = header.stored if as_stored else header.size
        camera = described if isinstance(described, Camera) else described(stored)
        sizes = (camera.width, camera.height), shape
        if unlike := [size for size in sizes if size is not None and not _same_shape(stored, size)]:
            misfits += unlike
            continue
        scale = min(1.0, factor / downscale)
        size = int(stored[0] * scale + 1e-6), int(stored[1] * scale + 1e-6)  # fractions of a pixel are left out
        if min(size) < 1:
            raise UserError("downscale leaves no picture", where=f"--downscale {downscale}", found=times(stored),
                            remedy="use a smaller factor")  # fmt: skip
        return Photograph(name, camera.resized(*size), PictureLoader(picture, stored, size, mask, as_stored))
    raise UserError("the picture is of another size", where=picture, expected=f"the shape of {times(misfits[0])}",
                    found=times(header.size))  # fmt: skip


def tell_turned(where: Path, photographs: Sequence[Photograph]) -> None:
    """A notice of pictures that EXIF turns: which are turned, and which are taken as they are stored."""
    loaders = [(one.name, one.load) for one in photographs if isinstance(one.load, PictureLoader)]
    turned = [name for name, load in loaders if not load.as_stored and read_header(load.path).orientation != 1]
    stored = [name for name, load in loaders if load.as_stored]
    because = "are not turned as EXIF says: their cameras fit otherwise"
    for what, names in (("are turned as EXIF says", turned), (because, stored)):
        notice(where, f"{len(names)} of {len(photographs)} pictures {what}", names)


def moved(photographs: Sequence[Photograph], frame: Frame) -> tuple[Photograph, ...]:
    """The photographs in the training frame."""
    P = frame.poses(poses_of([photograph.camera for photograph in photographs]))
    placed = zip(photographs, P, strict=True)
    return tuple(replace(one, camera=replace(one.camera, world_T_camera=pose)) for one, pose in placed)


def _same_shape(size: Size, other: Size) -> bool:
    (w, h), (width, height) = size, other
    return abs(w * height - h * width) <= max(SHAPE_TOLERANCE * h * width, width, height)
