"""The first stage: photographs, or the frames of a film, as pictures that every reader understands, in a folder of ours.

Pictures that are blurred or show the same as another are not used. `pictures.json` beside the folder keeps what was prepared.
"""

import contextlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from console import Progress, UserError
from console.atomic import write_file
from console.json_text import read_json_file
from training.posing.child_process import ask
from training.posing.photograph import PhotographFile, link_or_convert, read_photograph, same_view, write_picture
from training.scenes.files import distinct, is_hidden, times
from training.scenes.pictures import as_bytes, is_panorama, preview_of, read_mask
from training.scenes.pixels import notice_masks
from training.scenes.sources import MASKS, Source

IMAGES, RECORD, LOG = "images", "pictures.json", "log.txt"
BLURRED = 0.35  # of the median sharpness of the pictures to either side
AROUND = 7  # pictures to either side
MOST_BLURRED = 0.25  # of all pictures; where more seem so, they differ in what they show


@dataclass(frozen=True)
class Picture:
    name: str  # of its file in the folder
    display_name: str  # how the user knows it
    camera: str  # the same for pictures of one camera with one focal length
    focal: float | None = None  # in pixels, None where it is not known
    is_panorama: bool = False  # it shows all around


@dataclass(frozen=True)
class Prepared:
    pictures: tuple[Picture, ...]  # in the order of their names
    aside: Mapping[str, str]  # why pictures are not used, by the name that the user knows


def fingerprint(source: Source) -> list[list[object]]:
    """Names, sizes and times of the files and their masks: what was found for them holds as long as these stay."""
    masks = [] if source.masks is None else sorted(source.masks.rglob("*"))
    stats = [(source.name_of(file), file.stat()) for file in source.files]
    stats += [(file.name, file.stat()) for file in masks if file.is_file() and not is_hidden(file)]
    return [[name, stat.st_size, str(stat.st_mtime_ns)] for name, stat in stats]  # JSON would round them


def prepare(source: Source, work: Path, most_frames: int, bar: Progress) -> Prepared:
    """Pictures in a new folder, `work` / IMAGES. bar: counts files, or seconds of a film. UserError where none can be read."""
    (work / IMAGES).mkdir()
    return _frames(source, work, most_frames, bar) if source.kind == "film" else _photographs(source, work, bar)


def stored(work: Path, key: object) -> Prepared | None:
    """What was prepared before of the same files; None where it was not finished, or of others."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        values = read_json_file(work / RECORD)
        if values["key"] == key:
            return Prepared(tuple(Picture(**picture) for picture in values["pictures"]), values["aside"])
    return None


def store(work: Path, key: object, prepared: Prepared) -> None:
    """Keeps it for `stored`."""
    write_file(work / RECORD, json.dumps({"key": key, **asdict(prepared)}, indent=1))


class CameraGroup(NamedTuple):
    """The pictures of one camera."""

    names: Sequence[str]
    focal: float | None  # in pixels, None where it is not known
    is_panorama: bool


def camera_groups(pictures: Sequence[Picture]) -> list[CameraGroup]:
    """The pictures of each camera. They are panoramas where most look like some."""
    groups: dict[str, list[Picture]] = {}
    for picture in pictures:
        groups.setdefault(picture.camera, []).append(picture)
    found = []
    for group in groups.values():
        focals = [picture.focal for picture in group if picture.focal is not None]
        panoramas = sum(picture.is_panorama for picture in group)
        focal = float(np.median(focals)) if focals else None
        found.append(CameraGroup([picture.name for picture in group], focal, 2 * panoramas > len(group)))
    return found


def read_photographs(
    source: Source, on_file: Callable[[int, Path, bool], None]
) -> tuple[list[PhotographFile], dict[str, UserError]]:
    """All that can be read, and why the others cannot, by name. on_file: number, file, whether it could be read."""
    photographs, errors = [], {}
    for number, file in enumerate(source.files):
        try:
            photographs.append(read_photograph(file))
        except UserError as error:
            errors[source.name_of(file)] = error
        on_file(number, file, source.name_of(file) not in errors)
    return photographs, errors


def choose(
    source: Source, photographs: Sequence[PhotographFile], errors: Mapping[str, UserError]
) -> tuple[list[PhotographFile], dict[str, str]]:
    """Those that are neither blurred nor there before; and why the others, and those with errors, are not used, by name."""
    aside = {name: "; ".join(filter(None, (error.what, error.remedy))) for name, error in errors.items()}
    repeats = repeated([one.thumbnail for one in photographs])
    chosen = []
    is_blurred = blurred([one.sharpness for one in photographs])
    for photograph, earlier, bad in zip(photographs, repeats, is_blurred, strict=True):
        if earlier is not None:
            aside[source.name_of(photograph.file)] = f"the same as {source.name_of(photographs[earlier].file)}"
        elif bad:
            aside[source.name_of(photograph.file)] = "blurred"
        else:
            chosen.append(photograph)
    return chosen, aside


def blurred(sharpnesses: Sequence[float]) -> list[bool]:
    """Which pictures, in the order they were taken, are far less sharp than those before and those after them."""
    values = np.asarray(sharpnesses, np.float64)
    found = []
    for i, value in enumerate(values):
        sides = [side for side in (values[max(i - AROUND, 0) : i], values[i + 1 : i + 1 + AROUND]) if len(side)]
        found.append(bool(sides) and value < BLURRED * min(float(np.median(side)) for side in sides))
    return found if sum(found) <= MOST_BLURRED * len(found) else [False] * len(found)


def repeated(thumbnails: Sequence[np.ndarray]) -> list[int | None]:
    """For each picture the number of an earlier one that it repeats, None where it repeats none."""
    out: list[int | None] = []
    for thumbnail in thumbnails:
        kept = (j for j, repeats in enumerate(out) if repeats is None)
        out.append(next((j for j in kept if same_view(thumbnail, thumbnails[j])), None))
    return out


def masked_names(work: Path) -> list[str]:
    """Names of the prepared pictures that have a mask NAME.png, as COLMAP calls its own, sorted."""
    return sorted(file.name.removesuffix(".png") for file in (work / MASKS).glob("*.png"))


def _photographs(source: Source, work: Path, bar: Progress) -> Prepared:
    photographs, errors = read_photographs(source, lambda number, *_: bar.update(number))
    if len(photographs) < len(errors):
        raise next(iter(errors.values()))
    chosen, aside = choose(source, photographs, errors)
    pictures, extremes = [], {}
    # As COLMAP's lists can hold them: without blanks, leading # or backslashes
    plain = [re.sub(r"[\s#\\]+", "_", source.name_of(one.file).replace("/", "-")) for one in chosen]
    stems = distinct([name.rpartition(".")[0] or name for name in plain])
    for photograph, stem in zip(chosen, stems, strict=True):
        file = photograph.file
        try:
            name = link_or_convert(photograph, work / IMAGES, stem)
        except UserError as error:  # its header was whole
            aside[source.name_of(file)] = error.what
            continue
        picture = Picture(name, source.name_of(file), photograph.camera, photograph.focal, photograph.is_panorama)
        pictures.append(picture)
        if (mask := source.mask_of(file)) is not None:
            values = as_bytes(read_mask(mask, file))
            (work / MASKS).mkdir(exist_ok=True)
            write_picture(Image.fromarray(values), work / MASKS, name, lossy=False)
            extremes[source.name_of(mask)] = (values.min(), values.max())
    if extremes and not any(high for _, high in extremes.values()):
        raise UserError("all masks hide everything", where=source.masks, expected="white where the object is",
                        found=f"{len(extremes)} masks that are black", remedy="correct or remove the masks")  # fmt: skip
    notice_masks(source.masks, extremes)
    bar.update(len(source.files))
    return Prepared(tuple(pictures), aside)


def _frames(source: Source, work: Path, most: int, bar: Progress) -> Prepared:
    film = source.files[0]

    def on_progress(title: str, done: float, total: float) -> None:
        bar.total = total
        bar.update(done)

    request = {"film": str(film.resolve()), "images": str(work / IMAGES), "most": most}
    frames = ask("take_frames", request, work / LOG, on_progress)
    pictures, aside = [], {}
    for frame, bad in zip(frames, blurred([frame["sharpness"] for frame in frames]), strict=True):
        display_name = f"{source.name_of(film)} at {frame['seconds']:.2f} s"
        if bad:
            aside[display_name] = "blurred"
            (work / IMAGES / frame["name"]).unlink()
        else:
            panorama = is_panorama(preview_of(work / IMAGES / frame["name"]))
            pictures.append(Picture(frame["name"], display_name, times(frame["size"]), is_panorama=panorama))
    return Prepared(tuple(pictures), aside)
