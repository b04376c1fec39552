"""Files and folders that the viewer opens: what they hold, and requests for one."""

import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Literal

from console import UserError, not_written
from console.atomic import try_folder
from scenepack.files import PARAMS_NAME, ZIP_ERRORS
from training.scenes.files import PICTURE_SUFFIXES
from training.scenes.read import has_poses
from training.scenes.sources import find_source, is_film

Kind = Literal["pack", "run", "scene", "pictures", "session", "unknown"]
SESSION_SUFFIX = ".snerg"
POSED = "scene"  # in the folder for the results: the scene with the poses that were found
REPORT = "poses.json"  # what that says of itself


@dataclass(frozen=True)
class FileRequest:
    title: str
    kind: Literal["open", "folder", "save"]  # an existing file, a folder, or a file to write
    then: Callable[[Path], object]  # called with the path that was chosen
    suffixes: tuple[str, ...] = ()  # such as (".zip",)
    suggestion: str = ""
    start: Path | None = None  # the folder to begin in


def demo_pack() -> Path:
    return Path(__file__).parents[1] / "demo" / "demo.zip"


def kind_of(path: Path) -> Kind:
    """What is at `path`; no picture is decoded. pictures: photographs without poses, or a film."""
    if path.is_file():
        if path.suffix.lower() == SESSION_SUFFIX:
            return "session"
        if is_film(path):
            return "pictures"
        return "pack" if path.suffix.lower() == ".zip" and _holds_params(path) else "unknown"
    if (path / PARAMS_NAME).is_file() or (any(path.glob(f"*/{PARAMS_NAME}")) and not has_poses(path)):
        return "pack"
    if has_poses(path):
        return "scene"
    if any((path / folder / "config.json").is_file() for folder in ("", "run")):
        return "run"  # of snerg-train; or what snerg-make left when it was stopped
    if found_poses(path):
        return "scene"  # what snerg-make left when it was stopped before training
    try:
        return "pictures" if find_source(path) is not None else "unknown"
    except UserError:  # several films: whoever finds poses says so
        return "pictures"


def found_poses(path: Path) -> bool:
    """Whether `path` is a folder for results in which camera poses were found."""
    return (path / POSED / REPORT).is_file()


def pack_in(path: Path) -> Path:
    """`path`, or the folder just below it that holds a pack (snerg-make writes one beside its run)."""
    if path.is_dir() and not (path / PARAMS_NAME).is_file():
        return next((found.parent for found in sorted(path.glob(f"*/{PARAMS_NAME}"))), path)
    return path


def scene_around(path: Path) -> Path:
    """`path`, or where it is a folder of pictures inside a scene (SCENE/images, SCENE/images/left), that scene."""
    if not path.is_dir() or kind_of(path) not in ("pictures", "unknown"):
        return path
    if not any(child.suffix.lower() in PICTURE_SUFFIXES for child in chain(path.iterdir(), path.glob("*/*"))):
        return path
    return next((parent for parent in path.resolve().parents[:2] if has_poses(parent)), path)


def existing_folder(path: Path) -> Path:
    path = path.absolute()
    return next((folder for folder in (path, *path.parents) if os.path.isdir(folder)), Path(path.anchor))


def why_not_writable(folder: Path) -> str | None:
    """Why nothing can be written into `folder`, which need not be there yet, and what to do; None where it can. Tries it."""
    try:
        try_folder(folder)
    except OSError as error:
        words, remedy = not_written(error)
        return f"{folder} cannot be written: {words}; {remedy}."
    return None


def _holds_params(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.rsplit("/", 1)[-1] == PARAMS_NAME for name in archive.namelist())
    except (OSError, *ZIP_ERRORS):
        return True  # let the reader say what is wrong with it
