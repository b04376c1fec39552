"""From bare photographs or a film to a COLMAP scene, stage by stage.

OUT/posing holds unfinished work, from which a stopped process goes on. OUT/scene appears whole: images, sparse/0, and poses.json,
which says what it was made of and what was left out.
"""

import contextlib
import json
import math
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from console import Progress, UserError, progress
from console.atomic import is_leftover, locked_folder, replacing, write_file
from console.json_text import read_json_file
from training.posing import prepare
from training.posing.child_process import ask
from training.posing.prepare import IMAGES, LOG, Prepared, masked_names
from training.scenes.files import few, notice
from training.scenes.read import has_poses
from training.scenes.sources import FEWEST, MASKS, Source, require_source

SCENE, WORK, REPORT = "scene", "posing", "poses.json"
MARK = "README.txt"  # in WORK: it is ours
MARK_TEXT = "snerg keeps unfinished work here, to go on with. Nothing else is lost if you delete this folder.\n"
MODEL = "model"  # where training.posing.mapping leaves the largest
FORMAT = 1
FRAMES = 120  # of a film, at most
STAGE = "poses"
CONTINUE = "what is finished is kept; the same command line continues"
LEFT_OUT = "left_out.json"  # in WORK, for programs: why pictures are left out, and where they are
FEWEST_SHARE = 0.6  # of the pictures that must have a pose
CHECK = "snerg-make with --check shows which match"
OVERLAP = "take more photographs, each showing at least two thirds of what the one before shows"


def find_poses(source: Source, out: Path, *, seed: int = 0, most_frames: int = FRAMES) -> Path:
    """Makes the scene OUT/scene of the photographs or the film, unless it is there, and returns its path.

    most_frames: of a film. Ctrl-C raises a KeyboardInterrupt that says how to go on. UserError where too few photographs can be
    used or overlap, or a run was trained on an OUT/scene of other photographs. ModuleNotFoundError as `require`.
    """
    for note in source.notes:
        notice(source.path, note)
    key = {"files": prepare.fingerprint(source), "frames": most_frames if source.kind == "film" else 0}
    scene = out / SCENE
    if (scene / REPORT).is_file():
        if _key_of(scene) == key:
            return scene
        if (out / "run" / "config.json").is_file():
            raise UserError("holds a run of other photographs, or they were changed since", where=out,
                            expected=source.path, remedy="choose another --out")  # fmt: skip
    require(source)
    _require_ours(out)
    if source.kind == "photographs":
        _require_enough(source, len(source.files))  # before anything is written
    with locked_folder(out / WORK, "finding camera poses"):
        try:
            return _find(source, out, {**key, "seed": seed})
        except KeyboardInterrupt as interrupt:
            raise KeyboardInterrupt(CONTINUE) from interrupt


def posed_scene(path: Path, out: Path, *, anew: bool = False, seed: int = 0, most_frames: int = FRAMES) -> Path:
    """`path` itself where it has poses, unless `anew`; else what find_poses makes of it. UserError where it is neither."""
    if has_poses(path) and not anew:
        return path
    return find_poses(require_source(path), out, seed=seed, most_frames=most_frames)


def require(source: Source) -> None:
    """ModuleNotFoundError where a package is missing that this source needs. They are not imported here: large."""
    from importlib.util import find_spec

    for name in ("pycolmap", *(["av"] if source.kind == "film" else [])):
        if find_spec(name) is None:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def _require_ours(out: Path) -> None:
    """UserError where what will be replaced or emptied holds other files: the user's photographs, say."""
    for folder, mark in ((out / SCENE, REPORT), (out / WORK, MARK)):
        ours = (folder / mark).is_file() or not os.path.lexists(folder)
        if not ours and not (folder.is_dir() and all(is_leftover(entry.name) for entry in folder.iterdir())):
            raise UserError("is in the way: snerg did not make it", where=folder, remedy="choose another --out")


def _find(source: Source, out: Path, key: Mapping[str, Any]) -> Path:
    work = out / WORK
    prepared = prepare.stored(work, key)
    if prepared is None:
        for entry in work.iterdir():  # of other photographs, or of no use
            if entry.name != MARK:
                shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        write_file(work / MARK, MARK_TEXT)
        with _timed(work, "pictures"), progress("choosing pictures", len(source.files), stage=STAGE) as bar:
            prepared = prepare.prepare(source, work, key["frames"], bar)
        prepare.store(work, key, prepared)
    _warn_of_prepared(source, prepared, masked_names(work))
    _require_enough(source, len(prepared.pictures))
    found = _reconstructed(prepared, work, key["seed"])
    left_out = _report_rejections(source, work, prepared, found)
    unposed = [name for name in left_out if name not in prepared.aside]
    display_name = {picture.name: picture.display_name for picture in prepared.pictures}
    report = {
        "format": FORMAT, "key": {name: key[name] for name in ("files", "frames")}, "photographs": str(source.path.resolve()),
        "names": {name: display_name[name] for name in found["registered"]}, "unposed": unposed, "left_out": left_out,
        "aside": dict(prepared.aside), "points": found["points"], "error_pixels": round(found["error"], 3),
        "seconds": _seconds(work), "seed": key["seed"],
    }  # fmt: skip
    _assemble(out / SCENE, work, found["registered"], report)
    shutil.rmtree(work, ignore_errors=True)
    _warn_left_out(source, unposed, "no pose was found")
    return out / SCENE


def _reconstructed(prepared: Prepared, work: Path, seed: int) -> dict[str, Any]:
    """Features, matches and poses from the child process, each with its bar and its time."""
    request = {
        "images": str((work / IMAGES).resolve()), "work": str(work.resolve()), "seed": seed,
        "names": [picture.name for picture in prepared.pictures],
        "masks": str((work / MASKS).resolve()), "masked": masked_names(work), "groups": prepare.camera_groups(prepared.pictures),
    }  # fmt: skip
    with contextlib.ExitStack() as held:
        bar: Progress | None = None

        def on_progress(title: str, done: float, total: float) -> None:
            nonlocal bar
            if bar is None or bar.title != title:
                held.close()
                held.enter_context(_timed(work, title))
                bar = held.enter_context(progress(title, total, begun=done, stage=STAGE))
            bar.update(done)

        return ask("reconstruct", request, work / LOG, on_progress)


@contextlib.contextmanager
def _timed(work: Path, stage: str) -> Iterator[None]:
    """Adds the seconds of the block to those that the stage took before."""
    before, started = _seconds(work), time.monotonic()
    try:
        yield
    finally:
        seconds = round(before.get(stage, 0.0) + time.monotonic() - started, 1)
        with contextlib.suppress(OSError):
            write_file(work / "seconds.json", json.dumps({**before, stage: seconds}))


def _seconds(work: Path) -> dict[str, float]:
    with contextlib.suppress(OSError, ValueError, TypeError):
        return dict(read_json_file(work / "seconds.json"))
    return {}


def _assemble(scene: Path, work: Path, names: Sequence[str], report: Mapping[str, Any]) -> None:
    """Puts the scene in its place, whole: links or copies of the pictures that have a pose, and the model."""
    with replacing(scene, folder=True) as new:
        (new / "images").mkdir()
        for name in names:
            _link(work / IMAGES / name, new / "images" / name)
        shutil.copytree(work / MODEL, new / "sparse" / "0")
        for name in set(names) & set(masked_names(work)):
            (new / MASKS).mkdir(exist_ok=True)
            _link(work / MASKS / f"{name}.png", new / MASKS / f"{name}.png")
        write_file(new / REPORT, json.dumps(report, indent=1) + "\n")


def _link(picture: Path, target: Path) -> None:
    """Makes a hard link to a picture, or to the symbolic link that it is; `work` is deleted soon."""
    try:
        os.link(picture, target, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copyfile(picture, target, follow_symlinks=False)


def _key_of(scene: Path) -> Any:
    """The key of a finished scene; None where it cannot be read."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        report = read_json_file(scene / REPORT)
        return report["key"] if report["format"] == FORMAT else None


# --- messages about photographs that are left out -----------------------------------------------------------------------


def _warn_of_prepared(source: Source, prepared: Prepared, masked: Sequence[str]) -> None:
    """Notices of pictures that are not used, and why, and of those without a mask where others have one."""
    by_reason: dict[str, list[str]] = {}
    for name, reason in prepared.aside.items():
        if reason.startswith("the same as "):
            name, reason = f"{name} = {reason.removeprefix('the same as ')}", "repeated"
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        _warn_left_out(source, names, reason)
    without = [picture.display_name for picture in prepared.pictures if masked and picture.name not in set(masked)]
    count = f"{len(without)} photographs have no mask" if len(without) > 1 else "1 photograph has no mask"
    notice(source.path, f"{count}, all of it is used", without)


def _warn_left_out(source: Source, names: Sequence[str], reason: str) -> None:
    are = "pictures are" if len(names) > 1 else "picture is"
    notice(source.path, f"{len(names)} {are} left out: {reason}", names)


def _require_enough(source: Source, count: int) -> None:
    if count < FEWEST:
        what, remedy = "too few photographs to find camera poses", "20 to 100 from all around show a shape"
        if source.kind == "film":
            what, remedy = "too few frames of this film differ", "walk around what you film"
        raise UserError(what, where=source.path, expected=f"at least {FEWEST}", found=count, remedy=remedy)


def _report_rejections(source: Source, work: Path, prepared: Prepared, found: Mapping[str, Any]) -> dict[str, str]:
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
    enough = max(FEWEST, math.ceil(FEWEST_SHARE * len(prepared.pictures)))
    if len(registered) < enough:
        raise _too_few_poses(source, prepared, found, unposed, enough)
    return why


def _too_few_poses(
    source: Source, prepared: Prepared, found: Mapping[str, Any], unposed: Sequence[str], enough: int
) -> UserError:
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
    return UserError(f"only {registered} of {total} photographs have a camera pose", where=source.path,
                     expected=f"at least {enough}", found=text, remedy=f"{OVERLAP}, or remove these; {CHECK}")  # fmt: skip
