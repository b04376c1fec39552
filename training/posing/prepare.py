"""The first stage: photographs, or the frames of a film, as pictures that every reader understands, in a folder of ours.

What was prepared is kept in `pictures.json` beside that folder, so that a killed process need not do it again.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from console import Progress, UserError
from console.atomic import write_file
from console.json_text import read_json_file
from training.posing.camera_files import Look, look_at, put
from training.posing.child import ask
from training.posing.choice import blurred, repeated, sharpness, thumbnail
from training.posing.masks import MASKS, put_mask
from training.scenes.files import is_hidden
from training.scenes.pixels import notice_masks
from training.scenes.sources import Source

IMAGES, RECORD, LOG = "images", "pictures.json", "log.txt"


@dataclass(frozen=True)
class Picture:
    """name: of its file in the folder. told_as: how the user knows it. camera: the same for pictures of one camera with one
    focal length. focal: in pixels, None where it is not known.
    """

    name: str
    told_as: str
    camera: str
    focal: float | None = None


@dataclass(frozen=True)
class Prepared:
    """pictures: in the order of their names. aside: what is not used, with the reason, by the name that the user knows."""

    pictures: tuple[Picture, ...]
    aside: Mapping[str, str] = field(default_factory=dict)


def fingerprint(source: Source) -> list[list[object]]:
    """Names, sizes and times of the files and their masks: what was found for them holds as long as these stay."""
    masks = (
        []
        if source.masks is None
        else sorted(file for file in source.masks.rglob("*") if file.is_file() and not is_hidden(file))
    )
    stats = [(source.name_of(file), file.stat()) for file in source.files]
    stats += [(file.name, file.stat()) for file in masks]
    return [[name, stat.st_size, str(stat.st_mtime_ns)] for name, stat in stats]  # JSON would round them


def prepare(source: Source, work: Path, most_frames: int, bar: Progress) -> Prepared:
    """Pictures in `work` / IMAGES. bar: counts files, or the seconds of a film. UserError where nothing can be read."""
    folder = work / IMAGES
    for old in (folder, work / MASKS):
        shutil.rmtree(old, ignore_errors=True)
    folder.mkdir()
    if source.kind == "film":
        return _frames(source, work, most_frames, bar)
    return _photographs(source, folder, bar)


def stored(work: Path, key: object) -> Prepared | None:
    """What was prepared before of the same files; None where it was not finished, or of others."""
    try:
        values = read_json_file(work / RECORD)
        if values["key"] != key:
            return None
        return Prepared(tuple(Picture(**picture) for picture in values["pictures"]), values["aside"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def store(work: Path, key: object, prepared: Prepared) -> None:
    """Keeps it for `stored`."""
    write_file(work / RECORD, json.dumps({"key": key, **asdict(prepared)}, indent=1))


# --- photographs ------------------------------------------------------------------------------------------------------


def _photographs(source: Source, folder: Path, bar: Progress) -> Prepared:
    looks: list[tuple[Path, Look]] = []
    aside: dict[str, str] = {}
    first_error: UserError | None = None
    for done, file in enumerate(source.files):
        bar.update(done)
        try:
            looks.append((file, look_at(file)))
        except UserError as error:
            first_error = first_error or error
            aside[source.name_of(file)] = "; ".join(filter(None, (error.what, error.remedy)))
    if first_error is not None and len(looks) < len(aside):
        raise first_error
    chosen = chosen_looks(source, looks, aside)
    names = file_stems([source.name_of(file) for file, _ in chosen])
    pictures, extremes = [], {}
    for (file, look), name in zip(chosen, names, strict=True):
        try:
            pictures.append(Picture(put(file, look, folder, name), source.name_of(file), look.camera, look.focal))
        except UserError as error:  # its header was whole
            aside[source.name_of(file)] = error.what
            continue
        if (mask := source.mask_of(file)) is not None:
            values = put_mask(mask, file, folder.with_name(MASKS), pictures[-1].name)
            extremes[source.name_of(mask)] = (values.min(), values.max())
    if extremes and not any(high for _, high in extremes.values()):
        raise UserError("all masks hide everything", where=source.masks, expected="white where the object is",
                        found=f"{len(extremes)} masks that are black", remedy="mend or remove the masks")  # fmt: skip
    notice_masks(source.masks, extremes)
    bar.update(len(source.files))
    return Prepared(tuple(pictures), aside)


def chosen_looks(source: Source, looks: Sequence[tuple[Path, Look]], aside: dict[str, str]) -> list[tuple[Path, Look]]:
    """Those that are neither blurred nor there before; the others go aside."""
    repeats = repeated([look.digest for _, look in looks], [thumbnail(look.preview) for _, look in looks])
    is_blurred = blurred([sharpness(look.preview) for _, look in looks])
    chosen = []
    for (file, look), earlier, bad in zip(looks, repeats, is_blurred, strict=True):
        if earlier is not None:
            aside[source.name_of(file)] = f"the same as {source.name_of(looks[earlier][0])}"
        elif bad:
            aside[source.name_of(file)] = "blurred"
        else:
            chosen.append((file, look))
    return chosen


def file_stems(names: Sequence[str]) -> list[str]:
    """A name without suffix for each picture, no two alike, which COLMAP's lists of names can hold: no blanks, no leading #,
    no backslashes."""
    stems: list[str] = []
    taken: set[str] = set()
    for name in names:
        plain = re.sub(r"[\s#\\]+", "_", name.replace("/", "-"))
        stem = base = plain.rpartition(".")[0] or plain
        number = 1
        while stem.lower() in taken:
            number += 1
            stem = f"{base}-{number}"
        taken.add(stem.lower())
        stems.append(stem)
    return stems


# --- films ------------------------------------------------------------------------------------------------------------


def _frames(source: Source, work: Path, most: int, bar: Progress) -> Prepared:
    film = source.files[0]

    def tell(title: str, done: float, total: float) -> None:
        bar.total = total
        bar.update(done)

    request = {"film": str(film.resolve()), "images": str(work / IMAGES), "most": most}
    frames = ask("take_frames", request, work / LOG, tell)
    is_blurred = blurred([frame["sharpness"] for frame in frames]) if frames else []
    pictures, aside = [], {}
    for frame, bad in zip(frames, is_blurred, strict=True):
        told_as = f"{source.name_of(film)} at {frame['seconds']:.2f} s"
        if bad:
            aside[told_as] = "blurred"
            (work / IMAGES / frame["name"]).unlink()
        else:
            width, height = frame["size"]
            pictures.append(Picture(frame["name"], told_as, f"{width}x{height}"))
    return Prepared(tuple(pictures), aside)


def cameras(pictures: Sequence[Picture]) -> dict[str, list[Picture]]:
    """The pictures of each camera. A focal length that EXIF states for some of them alone would not be theirs."""
    groups: dict[str, list[Picture]] = {}
    for picture in pictures:
        groups.setdefault(picture.camera, []).append(picture)
    return groups


def focal_of(group: Sequence[Picture]) -> float | None:
    """The focal length of a camera's pictures, in pixels."""
    known = [picture.focal for picture in group if picture.focal is not None]
    return float(np.median(known)) if known else None
