"""Messages about photographs rejected during pose estimation."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from console import UserError
from console.atomic import write_file
from training.posing.prepare import IMAGES, Prepared
from training.scenes.files import few, notice
from training.scenes.sources import FEWEST, MASKS, Source

LEFT_OUT = "left_out.json"
FEWEST_SHARE = 0.6  # of the pictures that must have a pose
CHECK = "snerg-make with --check shows which match"
OVERLAP = "take more photographs, each showing at least two thirds of what the one before shows"


def warn_of_prepared(source: Source, prepared: Prepared, masked: Sequence[str]) -> None:
    """Notices of pictures that are not used, and why, and of those without a mask where others have one."""
    by_reason: dict[str, list[str]] = {}
    for name, reason in prepared.aside.items():
        if reason.startswith("the same as "):
            name, reason = f"{name} = {reason.removeprefix('the same as ')}", "repeated"
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        warn_left_out(source, names, reason)
    without = [picture.display_name for picture in prepared.pictures if masked and picture.name not in set(masked)]
    count = f"{len(without)} photographs have no mask" if len(without) > 1 else "1 photograph has no mask"
    notice(source.path, f"{count}, all of it is used", without)


def warn_left_out(source: Source, names: Sequence[str], reason: str) -> None:
    """A notice of pictures that are left out."""
    are = "pictures are" if len(names) > 1 else "picture is"
    notice(source.path, f"{len(names)} {are} left out: {reason}", names)


def require_enough(source: Source, count: int) -> None:
    """UserError where there are too few pictures."""
    if count < FEWEST:
        what, remedy = "too few photographs to find camera poses", "20 to 100 from all around show a shape"
        if source.kind == "film":
            what, remedy = "too few frames of this film differ", "walk around what you film"
        raise UserError(what, where=source.path, expected=f"at least {FEWEST}", found=count, remedy=remedy)


def report_rejections(source: Source, work: Path, prepared: Prepared, found: Mapping[str, Any]) -> dict[str, str]:
    """Why pictures have no pose or were set aside, by the names that the user knows. found: see mapping.reconstruct.

    Writes LEFT_OUT for programs. UserError where too few pictures have a pose.
    """
    registered, others = set(found["registered"]), {name for part in found["models"][1:] for name in part}
    why = {}
    for picture in prepared.pictures:
        if picture.name not in registered:
            alone = "matches too few others" if found["matched"].get(picture.name, 0) else "matches no other"
            why[picture.display_name] = "matches others, but not the rest" if picture.name in others else alone
    unposed = list(why)
    why |= prepared.aside
    files = {
        p.display_name: str((work / IMAGES / p.name).resolve()) for p in prepared.pictures if p.display_name in why
    }
    left_out = {"photographs": str(source.path.resolve()), "left_out": why, "files": files}
    write_file(work / LEFT_OUT, json.dumps(left_out, indent=1) + "\n")
    if len(registered) < max(FEWEST, math.ceil(FEWEST_SHARE * len(prepared.pictures))):
        raise _too_few_poses(source, prepared, found, unposed)
    return why


def _too_few_poses(source: Source, prepared: Prepared, found: Mapping[str, Any], unposed: Sequence[str]) -> UserError:
    total, registered = len(prepared.pictures), len(found["registered"])
    if found["is_static"]:
        still, matched = found["still"]
        mask = source.files[0].with_suffix(".png").name
        remedy = f"put a folder {MASKS} with {mask} and so on beside the photographs, white where the object is"
        if source.kind == "film":
            remedy = "take photographs instead, with masks beside them, or walk around it"
        elif source.masks is not None:
            remedy = f"the masks in {source.masks} must be black where nothing turns"
        return UserError(
            "the camera stands still and the background hides what turns before it", where=source.path,
            expected="photographs from all around, or a turntable before an empty background",
            found=f"{still} of {matched} pairs match at the same place of the picture",
            remedy=remedy,
        )  # fmt: skip
    if not registered:
        alone = [picture.display_name for picture in prepared.pictures if found["matched"].get(picture.name) == 0]
        text = f"{len(alone)} of {total} match no other: {few(alone)}"
        return UserError("the photographs do not overlap enough to find camera poses", where=source.path,
                         found=text if alone else "no two show one thing from two places",
                         remedy=f"{OVERLAP}; {CHECK}")  # fmt: skip
    parts = [len(set(part) - set(found["registered"])) for part in found["models"][1:]]
    apart = [f"{count} of these" for count in parts if count]
    text = f"none for {few(unposed)}" + (f"; {' and '.join(apart)} match one another alone" if apart else "")
    enough = max(FEWEST, math.ceil(FEWEST_SHARE * total))
    return UserError(f"only {registered} of {total} photographs have a camera pose", where=source.path,
                     expected=f"at least {enough}", found=text, remedy=f"{OVERLAP}, or remove these; {CHECK}")  # fmt: skip
