"""What lies in a folder without poses: photographs, or a film. Told by names and a film's first bytes; nothing is decoded."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from console import UserError
from training.scenes.files import find_masks

PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp", ".heic", ".heif")
FILMS = (".mp4", ".m4v", ".mov", ".webm", ".mkv")
HEAD = 12  # bytes of a film that tell its container
FEWEST = 8  # pictures that must have a pose in the end; of fewer no scene can come
SUBFOLDER = "images"  # where other programs keep a scene's pictures
MASKS = "masks"  # beside the photographs, or beside the folder SUBFOLDER that they are in


@dataclass(frozen=True)
class Source:
    """path: the folder or the film, as it was named. files: the pictures in the order of their names; or the one film."""

    kind: Literal["photographs", "film"]
    path: Path
    files: tuple[Path, ...]

    @property
    def folder(self) -> Path:
        """What the names of `files` are told relative to."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def masks(self) -> Path | None:
        """The folder of masks beside the photographs; None where there is none."""
        if self.kind == "film":
            return None
        beside = [self.path / MASKS, *([self.path.parent / MASKS] if self.path.name == SUBFOLDER else [])]
        return next((folder for folder in beside if folder.is_dir()), None)

    def mask_of(self, file: Path) -> Path | None:
        """The mask of a photograph, by its name within the source, or else by its own; None where there is none."""
        folder = self.masks
        if folder is None:
            return None
        within = self.name_of(file).removeprefix(f"{SUBFOLDER}/")
        return next((mask for mask in find_masks(folder, [within, file.name]) if mask is not None), None)

    def name_of(self, file: Path) -> str:
        """A file's name for messages."""
        return file.relative_to(self.folder).as_posix()


def find_source(path: Path) -> Source | None:
    """The photographs or the film at `path`; None where there are none. A scene with poses is not looked for.

    Photographs lie in the folder itself, or else in its `images`, or else in folders just below. A folder without
    photographs may hold one film. Folders of masks are none of photographs. UserError where it holds several.
    """
    if path.is_file():
        return Source("film", path, (path,)) if is_film(path) else None
    if not path.is_dir():
        return None
    others = (folder for folder in path.glob("*/") if not folder.name.startswith(MASKS))
    for folders in ((path,), (path / SUBFOLDER,), tuple(others)):
        found = [file for folder in folders if folder.is_dir() for file in folder.iterdir() if _is_picture(file)]
        if found:
            return Source("photographs", path, tuple(sorted(found, key=lambda file: in_order(str(file)))))
    films = sorted(file for file in path.iterdir() if is_film(file))
    if len(films) > 1:
        raise UserError("several films, and no photographs", where=path, expected="one film",
                        found=", ".join(film.name for film in films[:4]), remedy="name one of them")  # fmt: skip
    return Source("film", path, (films[0],)) if films else None


def is_film(path: Path) -> bool:
    """Whether a file is named as a film that can be read."""
    return path.suffix.lower() in FILMS and path.is_file()


def container_of(film: Path) -> str | None:
    """FFmpeg's name for a film's container, "mp4" or "matroska", by its first bytes; None for any other."""
    with film.open("rb") as file:
        head = file.read(HEAD)
    if head[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):  # QuickTime may begin with any of them
        return "mp4"
    return "matroska" if head.startswith(b"\x1a\x45\xdf\xa3") else None


def in_order(name: str) -> list[tuple[int, int, str]]:
    """A key that sorts names with their numbers as numbers: IMG_9.jpg, IMG_10.jpg."""
    parts = re.split(r"(\d+)", name.lower())
    return [(0, int(part), "") if part.isascii() and part.isdigit() else (1, 0, part) for part in parts if part]


def _is_picture(file: Path) -> bool:
    return file.suffix.lower() in PICTURES and not file.name.startswith(".") and file.is_file()
