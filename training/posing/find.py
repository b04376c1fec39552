"""From bare photographs or a film to a COLMAP scene: the stages, and what to say where they end too soon.

OUT/posing holds the work while it goes on; whoever is stopped or killed goes on from there. OUT/scene appears whole: images,
sparse/0, and poses.json, which says what it was made of and what was left out.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from console import Notice, Progress, UserError, progress
from console.atomic import is_leftover, replacing, write_file
from console.json_text import read_json_file
from training.lock import only_one_trains
from training.posing.child import ask
from training.posing.prepare import IMAGES, LOG, Prepared, cameras, fingerprint, focal_of, prepare, store, stored
from training.scenes.read import has_poses
from training.scenes.sources import FEWEST, Source, find_source

SCENE, WORK, REPORT, TABLE = "scene", "posing", "poses.json", "photographs.txt"
MARK = "README.txt"  # in WORK: it is ours
MARK_TEXT = "snerg keeps unfinished work here, to go on with. Nothing else is lost if you delete this folder.\n"
MODEL = "model"  # where training.posing.mapping leaves the largest
FORMAT = 1
FRAMES = 120  # of a film, at most
FEWEST_SHARE = 0.6  # of the pictures that must have a pose
NAMED = 8  # pictures that a message names
STAGE = "poses"
CONTINUE = "what is finished is kept; the same command line continues"
OVERLAP = "take more photographs, each showing at least two thirds of what the one before shows"


def find_poses(source: Source, out: Path, *, seed: int = 0, most_frames: int = FRAMES) -> Path:
    """The scene OUT/scene of the photographs or the film: made, gone on with, or there already.

    most_frames: of a film. Ctrl-C raises KeyboardInterrupt that says how to go on. UserError where too few photographs can be
    used or overlap, and where OUT/scene is of other photographs and a run was trained on it. ModuleNotFoundError where
    pycolmap, or for films PyAV, is not installed.
    """
    key = {"files": fingerprint(source), "frames": most_frames if source.kind == "film" else 0}
    scene = out / SCENE
    if (scene / REPORT).is_file():
        if _made_of(scene) == key:
            return scene
        if (out / "run" / "config.json").is_file():
            raise UserError("holds a run of other photographs, or they were changed since", where=out,
                            expected=source.path, remedy="choose another --out")  # fmt: skip
    require(source)
    _require_ours(out)
    if source.kind == "photographs":
        _require_enough(source, len(source.files))  # before anything is written
    with only_one_trains(out / WORK, "finding camera poses"), _told_how_to_go_on():
        return _find(source, out, {**key, "seed": seed})


def posed_scene(path: Path, out: Path, *, seed: int = 0, most_frames: int = FRAMES) -> Path:
    """`path` itself where it has poses, or is nothing whose poses can be found; else the scene that find_poses makes of it."""
    source = None if has_poses(path) else find_source(path)
    return path if source is None else find_poses(source, out, seed=seed, most_frames=most_frames)


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
    prepared = stored(work, key)
    if prepared is None:
        for entry in work.iterdir():  # of other photographs, or of no use
            if entry.name != MARK:
                shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
        write_file(work / MARK, MARK_TEXT)
        with _timed(work, "pictures"), progress("choosing pictures", len(source.files), stage=STAGE) as bar:
            prepared = prepare(source, work, key["frames"], bar)
        store(work, key, prepared)
    _tell_aside(source, prepared)
    _require_enough(source, len(prepared.pictures))
    found = _asked(prepared, work, key["seed"])
    by_name = {picture.name: picture for picture in prepared.pictures}
    unposed = [picture.told_as for name, picture in by_name.items() if name not in set(found["registered"])]
    _write_table(work, prepared, found)
    _require_poses(source, work, prepared, found, unposed)
    report = {
        "format": FORMAT, "key": {name: key[name] for name in ("files", "frames")}, "photographs": str(source.path.resolve()),
        "names": {name: by_name[name].told_as for name in found["registered"]}, "unposed": unposed,
        "aside": dict(prepared.aside), "points": found["points"], "error_pixels": round(found["error"], 3),
        "seconds": _seconds(work), "seed": key["seed"],
    }  # fmt: skip
    _assemble(out / SCENE, work, found["registered"], report)
    shutil.rmtree(work, ignore_errors=True)
    if unposed:
        text = f"{_left_out(len(unposed))}: no pose was found ({_few(unposed)})"
        warnings.warn(Notice(f"{source.path}: {text}"), stacklevel=2)
    return out / SCENE


# --- stages -----------------------------------------------------------------------------------------------------------


def _asked(prepared: Prepared, work: Path, seed: int) -> dict[str, Any]:
    """Features, matches and poses from the child process, each with its bar and its time."""
    request = {
        "images": str((work / IMAGES).resolve()), "work": str(work.resolve()), "seed": seed,
        "names": [picture.name for picture in prepared.pictures],
        "groups": [
            {"names": [picture.name for picture in group], "focal": focal_of(group)}
            for group in cameras(prepared.pictures).values()
        ],
    }  # fmt: skip
    with contextlib.ExitStack() as held:
        bar: Progress | None = None

        def tell(title: str, done: float, total: float) -> None:
            nonlocal bar
            if bar is None or bar.title != title:
                held.close()
                held.enter_context(_timed(work, title))
                bar = held.enter_context(progress(title, total, begun=done, stage=STAGE))
            bar.update(done)

        return ask("reconstruct", request, work / LOG, tell)


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
    try:
        return dict(read_json_file(work / "seconds.json"))
    except (OSError, ValueError, TypeError):
        return {}


def _assemble(scene: Path, work: Path, names: Sequence[str], report: Mapping[str, Any]) -> None:
    """Puts the scene in its place, whole: links or copies of the pictures that have a pose, and the model."""
    with replacing(scene, folder=True) as new:
        (new / "images").mkdir()
        for name in names:
            picture = work / IMAGES / name
            if picture.is_symlink():
                os.symlink(os.readlink(picture), new / "images" / name)
            else:
                _linked(picture, new / "images" / name)
        shutil.copytree(work / MODEL, new / "sparse" / "0")
        write_file(new / REPORT, json.dumps(report, indent=1) + "\n")


def _linked(picture: Path, target: Path) -> None:
    try:
        os.link(picture, target)  # `work` goes away soon
    except OSError:
        shutil.copyfile(picture, target)


def _made_of(scene: Path) -> Any:
    """The key of a finished scene; None where it cannot be told."""
    try:
        report = read_json_file(scene / REPORT)
        return report["key"] if report["format"] == FORMAT else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


@contextlib.contextmanager
def _told_how_to_go_on() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(CONTINUE) from interrupt


# --- what is told -----------------------------------------------------------------------------------------------------


def _tell_aside(source: Source, prepared: Prepared) -> None:
    by_reason: dict[str, list[str]] = {}
    for name, reason in prepared.aside.items():
        if reason.startswith("the same as "):
            name, reason = f"{name} = {reason.removeprefix('the same as ')}", "repeated"
        by_reason.setdefault(reason, []).append(name)
    for reason, names in by_reason.items():
        warnings.warn(Notice(f"{source.path}: {_left_out(len(names))}: {reason} ({_few(names)})"), stacklevel=2)


def _require_enough(source: Source, count: int) -> None:
    if count >= FEWEST:
        return
    if source.kind == "film":
        raise UserError("too few frames of this film differ", where=source.path, expected=f"at least {FEWEST}",
                        found=count, remedy="walk around what you film")  # fmt: skip
    raise UserError("too few photographs to find camera poses", where=source.path, expected=f"at least {FEWEST}",
                    found=count, remedy="20 to 100 from all around show a shape")  # fmt: skip


def _require_poses(
    source: Source, work: Path, prepared: Prepared, found: Mapping[str, Any], unposed: Sequence[str]
) -> None:
    """UserError, with names, where too few pictures have a pose."""
    total, registered = len(prepared.pictures), len(found["registered"])
    if registered >= max(FEWEST, FEWEST_SHARE * total):
        return
    told_as = {picture.name: picture.told_as for picture in prepared.pictures}
    alone = [told_as[name] for name, count in found["matched"].items() if count == 0]
    table = f"table of all: {work / TABLE}"
    if not registered:
        what = "the photographs do not overlap enough to find camera poses"
        text = (
            f"{len(alone)} of {total} match no other: {_few(alone)}"
            if alone
            else "no two show one thing from two places"
        )
        raise UserError(what, where=source.path, found=text, remedy=f"{OVERLAP}; {table}")
    raise UserError(f"only {registered} of {total} photographs have a camera pose", where=source.path,
                    expected=f"at least {max(FEWEST, round(FEWEST_SHARE * total))}", found=f"none for {_few(unposed)}",
                    remedy=f"{OVERLAP}, or remove these; {table}")  # fmt: skip


def _write_table(work: Path, prepared: Prepared, found: Mapping[str, Any]) -> None:
    """What was found of each picture, for people."""
    registered = set(found["registered"])
    rows = [("features", "matches", "pose", "photograph")]
    rows += [(str(found["features"].get(p.name, 0)), str(found["matched"].get(p.name, 0)),
              "yes" if p.name in registered else "no", p.told_as) for p in prepared.pictures]  # fmt: skip
    rows += [("", "", reason, name) for name, reason in prepared.aside.items()]
    lines = [f"{features:>8}  {matches:>7}  {pose:<4}  {name}" for features, matches, pose, name in rows]
    write_file(work / TABLE, "\n".join(lines) + "\n")


def _left_out(count: int) -> str:
    return f"{count} pictures are left out" if count > 1 else "1 picture is left out"


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:NAMED]) + (f", … ({len(names)} in all)" if len(names) > NAMED else "")
