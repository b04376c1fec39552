"""What is told of the pictures that no scene comes of: by name, in one line, and all of them as a table."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from console import Notice, UserError
from console.atomic import write_file
from training.posing.prepare import IMAGES, Prepared
from training.posing.stillness import stands_still
from training.scenes.sources import FEWEST, MASKS, Source

TABLE, LEFT_OUT = "photographs.txt", "left_out.json"
FEWEST_SHARE = 0.6  # of the pictures that must have a pose
NAMED = 8  # pictures that a message names
MOST_ROWS = 60  # of a table that is printed
OVERLAP = "take more photographs, each showing at least two thirds of what the one before shows"


def tell_aside(source: Source, prepared: Prepared) -> None:
    """Says which pictures are not used, and why."""
    by_reason: dict[str, list[str]] = {}
    for name, reason in prepared.aside.items():
        if reason.startswith("the same as "):
            name, reason = f"{name} = {reason.removeprefix('the same as ')}", "repeated"
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        warnings.warn(Notice(f"{source.path}: {left_out(len(names))}: {reason} ({few(names)})"), stacklevel=2)


def require_enough(source: Source, count: int) -> None:
    """UserError where there are too few pictures."""
    if count >= FEWEST:
        return
    if source.kind == "film":
        raise UserError("too few frames of this film differ", where=source.path, expected=f"at least {FEWEST}",
                        found=count, remedy="walk around what you film")  # fmt: skip
    raise UserError("too few photographs to find camera poses", where=source.path, expected=f"at least {FEWEST}",
                    found=count, remedy="20 to 100 from all around show a shape")  # fmt: skip


def require_poses(
    source: Source, work: Path, prepared: Prepared, found: Mapping[str, Any], unposed: Sequence[str]
) -> None:
    """UserError, with names, where too few pictures have a pose; the table of all is printed before."""
    total, registered = len(prepared.pictures), len(found["registered"])
    enough = max(FEWEST, math.ceil(FEWEST_SHARE * total))
    if registered >= enough:
        return
    told_as = {picture.name: picture.told_as for picture in prepared.pictures}
    if total <= MOST_ROWS:
        print((work / TABLE).read_text(encoding="utf-8"), flush=True)
    table = f"table of all: {work / TABLE}"
    if stands_still(*found["still"]):
        still, matched = found["still"]
        raise UserError(
            "the camera stands still and the background hides what turns before it", where=source.path,
            expected="photographs from all around, or a turntable before an empty background",
            found=f"{still} of {matched} pairs match at the same place of the picture",
            remedy=_mask_remedy(source),
        )  # fmt: skip
    if not registered:
        alone = [told_as[name] for name, count in found["matched"].items() if count == 0]
        text = (
            f"{len(alone)} of {total} match no other: {few(alone)}"
            if alone
            else "no two show one thing from two places"
        )
        raise UserError("the photographs do not overlap enough to find camera poses", where=source.path, found=text,
                        remedy=f"{OVERLAP}; {table}")  # fmt: skip
    parts = [len(set(part) - set(found["registered"])) for part in found["models"][1:]]
    apart = [f"{count} of these" for count in parts if count]
    text = f"none for {few(unposed)}" + (f"; {' and '.join(apart)} match one another alone" if apart else "")
    raise UserError(f"only {registered} of {total} photographs have a camera pose", where=source.path,
                    expected=f"at least {enough}", found=text, remedy=f"{OVERLAP}, or remove these; {table}")  # fmt: skip


def _mask_remedy(source: Source) -> str:
    if source.kind == "film":
        return "take photographs instead, with masks beside them, or walk around it"
    name = source.files[0].with_suffix(".png").name
    if source.masks is None:
        return f"put a folder {MASKS} with {name} and so on beside the photographs, white where the object is"
    return f"the masks in {source.masks} must be black where nothing turns"


def write_table(work: Path, prepared: Prepared, found: Mapping[str, Any]) -> None:
    """What was found of each picture, for people."""
    part_of = {
        name: f"part {number}" for number, part in reversed(list(enumerate(found["models"], 1))) for name in part
    }
    part_of |= dict.fromkeys(found["registered"], "yes")
    rows = [("features", "matches", "pose", "photograph")]
    rows += [(str(found["features"].get(p.name, 0)), str(found["matched"].get(p.name, 0)),
              part_of.get(p.name, "no"), p.told_as) for p in prepared.pictures]  # fmt: skip
    rows += [("", "", reason, name) for name, reason in prepared.aside.items()]
    wide = max(len(pose) for _, _, pose, _ in rows)
    lines = [f"{features:>8}  {matches:>7}  {pose:<{wide}}  {name}" for features, matches, pose, name in rows]
    write_file(work / TABLE, "\n".join(lines) + "\n")


def why_left_out(prepared: Prepared, found: Mapping[str, Any]) -> dict[str, str]:
    """Why pictures have no pose or were set aside, by the names that the user knows."""
    registered, apart = set(found["registered"]), {name for part in found["models"][1:] for name in part}
    why = {}
    for picture in prepared.pictures:
        if picture.name not in registered:
            alone = "matches no other" if not found["matched"].get(picture.name, 0) else "matches too few others"
            why[picture.told_as] = "matches others, but not the rest" if picture.name in apart else alone
    return {**why, **prepared.aside}


def write_left_out(source: Source, work: Path, prepared: Prepared, why: Mapping[str, str]) -> None:
    """The same for programs, with the files where these are not the user's own."""
    files = {p.told_as: str((work / IMAGES / p.name).resolve()) for p in prepared.pictures if p.told_as in why}
    said = {"photographs": str(source.path.resolve()), "left_out": dict(why), "files": files}
    write_file(work / LEFT_OUT, json.dumps(said, indent=1) + "\n")


def tell_masks(source: Source, prepared: Prepared, masked: Sequence[str]) -> None:
    """Says which pictures have no mask, where others have one."""
    without = [picture.told_as for picture in prepared.pictures if picture.name not in set(masked)]
    if masked and without:
        count = f"{len(without)} photographs have no mask" if len(without) > 1 else "1 photograph has no mask"
        warnings.warn(Notice(f"{source.path}: {count}, all of it is used ({few(without)})"), stacklevel=2)


def left_out(count: int) -> str:
    """So many pictures are left out, in words."""
    return f"{count} pictures are left out" if count > 1 else "1 picture is left out"


def few(names: Sequence[str]) -> str:
    """The first of some names, and how many there are."""
    return ", ".join(names[:NAMED]) + (f", … ({len(names)} in all)" if len(names) > NAMED else "")
