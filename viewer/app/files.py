"""Files and folders that the viewer opens: what they hold, and the line that a path is typed into.

viewer.panels.open_dialog draws it; this module does not know imgui.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from urllib.parse import unquote, urlsplit

from console import UserError, not_written
from console.results import try_folder
from scenepack.files import PARAMS_NAME, ZIP_ERRORS
from training.scenes.files import PICTURE_SUFFIXES
from training.scenes.sources import FILMS, find_source, is_film

Kind = Literal["pack", "run", "scene", "pictures", "session", "unknown"]
SESSION_SUFFIX = ".snerg"
POSED, REPORT = (
    "scene",
    "poses.json",
)  # a scene whose poses were found, in the folder for the results; what it says of itself
SCENE_FILES = (
    "transforms_train.json",
    "transforms.json",
    "poses_bounds.npy",
    "sparse/0/cameras.bin",
    "sparse/cameras.bin",
    "sparse/0/cameras.txt",
    "sparse/cameras.txt",
)


@dataclass(frozen=True)
class FileRequest:
    """A path that the user is asked for. kind: an existing file, a folder, or a file to write.

    suffixes: such as (".zip",). then: called with the path that was chosen. start: the folder to begin in.
    """

    title: str
    kind: Literal["open", "folder", "save"]
    then: Callable[[Path], object]
    suffixes: tuple[str, ...] = ()
    suggestion: str = ""
    start: Path | None = None


def kind_of(path: Path) -> Kind:
    """What is at `path`, told by names alone. pictures: photographs without poses, or a film."""
    if path.is_file():
        if path.suffix.lower() == SESSION_SUFFIX:
            return "session"
        if is_film(path):
            return "pictures"
        return "pack" if path.suffix.lower() == ".zip" and _holds_params(path) else "unknown"
    if (path / PARAMS_NAME).is_file() or (any(path.glob(f"*/{PARAMS_NAME}")) and not _is_scene(path)):
        return "pack"
    if _is_scene(path):
        return "scene"
    if any((path / folder / "config.json").is_file() for folder in ("", "run")):
        return "run"  # of snerg-train; or what snerg-make left when it was stopped
    if found_poses(path):
        return "scene"  # what snerg-make left when it was stopped before training
    return "pictures" if _bare(path) else "unknown"


def found_poses(path: Path) -> bool:
    """Whether `path` is a folder for results in which camera poses were found."""
    return (path / POSED / REPORT).is_file()


def pack_in(path: Path) -> Path:
    """`path`, or the folder just below it that holds a pack (snerg-make writes one beside its run)."""
    if path.is_dir() and not (path / PARAMS_NAME).is_file():
        for found in sorted(path.glob(f"*/{PARAMS_NAME}")):
            return found.parent
    return path


def scene_around(path: Path) -> Path:
    """`path`, or where it is a folder of pictures inside a scene (SCENE/images, SCENE/images/left), that scene."""
    if not path.is_dir() or kind_of(path) not in ("pictures", "unknown"):
        return path
    if not any(_holds_pictures(folder) for folder in (path, *path.glob("*/"))):
        return path
    return next((parent for parent in path.resolve().parents[:2] if _is_scene(parent)), path)


def _bare(path: Path) -> bool:
    try:
        return find_source(path) is not None
    except UserError:  # several films: whoever finds poses says so
        return True


def _holds_pictures(folder: Path) -> bool:
    return folder.is_dir() and any(child.suffix.lower() in PICTURE_SUFFIXES for child in folder.iterdir())


def existing_folder(path: Path) -> Path:
    """`path`, or the nearest folder above it that is there."""
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


def _is_scene(path: Path) -> bool:
    return any((path / name).is_file() for name in SCENE_FILES)


def _holds_params(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.rsplit("/", 1)[-1] == PARAMS_NAME for name in archive.namelist())
    except (OSError, *ZIP_ERRORS):
        return True  # let the reader say what is wrong with it


# --- Open prompt ---

SHOWN = 8
MOST_ENTRIES = 5000  # of a folder that are looked at
OPENABLE = (".zip", SESSION_SUFFIX, *FILMS)


def path_in(text: str) -> Path | None:
    """The existing path that a text names, as file managers and shells copy paths; None for any other text."""
    text = text.strip().splitlines()[0].strip() if text.strip() else ""
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        text = text[1:-1]
    if text.startswith("file://"):
        text = unquote(urlsplit(text).path)
    if not looks_like_path(text):
        return None
    path = expanded(text)
    return path if _there(path) else None


def expanded(text: str) -> Path:
    """The path with ~ replaced by the home folder; unchanged if there is no such user, as in ~0."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)


def looks_like_path(text: str) -> bool:
    """Whether a text can only be meant as a path."""
    text = text.strip().strip("'\"")
    return text.startswith(("/", "~", "./", "../", "file://")) or Path(text).is_absolute()


def _there(path: Path) -> bool:
    try:
        return os.path.exists(path)
    except ValueError:  # a null byte
        return False


@dataclass
class OpenPrompt:
    """State of the prompt."""

    recent: Sequence[Path]
    other: bool = False  # whether it asks for a pack to compare with
    text: str = ""  # as typed
    picked: int | None = None  # index of the suggestion that Enter opens; None: the typed path
    problem: str = ""  # why the typed path cannot be opened
    _listed: tuple[str, list[Path]] | None = None
    _kinds: dict[Path, Kind] = field(default_factory=dict)

    @property
    def lines(self) -> list[Path]:
        """Suggestions below the text: recent paths that match it, or entries of the folder that is typed."""
        if self._listed is None or self._listed[0] != self.text:
            self._listed = self.text, suggestions(self.text, self.recent)
        return self._listed[1]

    def kind(self, path: Path) -> Kind:
        """What lies there, looked up once."""
        if path not in self._kinds:
            try:
                self._kinds[path] = kind_of(path)
            except OSError:
                self._kinds[path] = "unknown"
        return self._kinds[path]

    def type(self, text: str) -> None:
        """The text was changed."""
        if text != self.text:
            self.text, self.picked, self.problem = text, None, ""

    def step(self, by: int) -> None:
        """Moves the selection; up from the first suggestion returns to the text."""
        at = (-1 if self.picked is None else self.picked) + by
        self.picked = None if at < 0 else min(at, len(self.lines) - 1) if self.lines else None

    def take(self, line: int | None = None) -> Path | None:
        """The path to open: the given suggestion, the picked one, or the typed path.

        None if the prompt stays open: it enters a plain folder, and sets `problem` for a path that does not exist.
        """
        picked = self.picked if line is None else line
        if picked is None and (named := path_in(self.text)) is not None:
            return named
        if picked is None and looks_like_path(self.text):
            self.problem = f"There is nothing at {self.text.strip()}."
            return None
        if picked is None and not (self.text.strip() and self.lines):
            self.problem = "Type a path, or choose one."
            return None
        path = self.lines[picked or 0]
        if path.is_dir() and self.kind(path) == "unknown":
            self.type(str(path) + os.sep)
            return None
        return path


def suggestions(text: str, recent: Sequence[Path]) -> list[Path]:
    """At most SHOWN paths: entries of the folder that is typed, as far as they could be opened; else recent ones whose path
    holds every word of the text.
    """
    if looks_like_path(text):
        return _entries(text.strip())
    words = text.lower().split()
    return [path for path in recent if all(word in str(path).lower() for word in words)][:SHOWN]


def _entries(text: str) -> list[Path]:
    typed = expanded(text)
    folder, stem = (typed, "") if text.endswith((os.sep, "/")) or text == "~" else (typed.parent, typed.name.lower())
    found: list[tuple[bool, str]] = []
    try:
        with os.scandir(folder) as entries:
            for _, entry in zip(range(MOST_ENTRIES), entries, strict=False):
                name = entry.name.lower()
                if not name.startswith(stem) or (name.startswith(".") and not stem.startswith(".")):
                    continue
                if entry.is_dir() or name.endswith(OPENABLE):
                    found.append((not entry.is_dir(), entry.name))
    except (OSError, ValueError):
        return []
    return [folder / name for _, name in sorted(found, key=lambda item: (item[0], item[1].lower()))[:SHOWN]]
