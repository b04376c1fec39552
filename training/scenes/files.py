"""Finding the files that a scene's description names, also where the disk spells them otherwise.

Descriptions travel between systems and programs: a backslash for a slash, another case, composed or decomposed accents, a
missing, extra or changed suffix, a folder too many or too few in front. A file is found by the strictest rule that leads to
one file alone:

    1. the name as it stands
    2. the same name in normal form: "/" between parts, no "." parts, Unicode composed (NFC), case folded
    3. the same, with another suffix of a picture, or none
    4. 2 and 3 without leading folders of the name, one after the other
"""

from __future__ import annotations

import os
import unicodedata
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from training.scenes.picture_formats import PICTURE_SUFFIXES, UNREAD_FORMATS

MASK_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
# What systems leave beside files, but for names that begin with a dot: Windows, macOS, network disks.
SYSTEM_FILES = ("thumbs.db", "ehthumbs.db", "desktop.ini", "$recycle.bin", "system volume information", "__macosx", "icon\r",
                "@eadir", "#recycle", "lost+found")  # fmt: skip


def clean_name(name: str) -> str:
    """A name of a description as we show and compare it: with "/" between parts, without "." parts and drive, composed."""
    parts = [part for part in unicodedata.normalize("NFC", name).replace("\\", "/").split("/") if part not in ("", ".")]
    return "/".join(parts[1:] if parts and parts[0].endswith(":") else parts)


def without_suffix(name: str) -> str:
    """A name without its suffix, where that is one of a picture: r_0.5 has none."""
    return name[: -len(suffix)] if (suffix := _suffix(name)) else name


def is_hidden(path: Path) -> bool:
    """Whether a file or a folder is the system's own, by its name: ._IMG_1.jpg, __MACOSX, Thumbs.db."""
    return path.name.startswith(".") or path.name.lower() in SYSTEM_FILES


def visible_files(folder: Path, suffixes: Sequence[str] = PICTURE_SUFFIXES) -> list[Path]:
    """The files directly in a folder with one of the suffixes, sorted by name; without those that systems hide."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in suffixes and not is_hidden(p) and p.is_file())


class FileFinder:
    """Finds files below `roots`, of which the first that holds a file wins; folders are listed once."""

    def __init__(self, *roots: Path, suffixes: Sequence[str] = PICTURE_SUFFIXES) -> None:
        self._roots = roots
        self._suffixes = sorted(suffixes, key=lambda suffix: suffix != ".png")  # r_0 is r_0.png, where that is there
        self._listings: dict[Path, dict[str, list[Path]]] = {}

    def find(self, name: str) -> Path | None:
        """The file of that name by the rules above; None where there is none, or where several would do as well."""
        for root in self._roots:
            if os.path.isfile(root / name):  # Path.is_file raises where no file could have such a name
                return root / name
        cleaned = clean_name(name)
        parts = cleaned.split("/") if cleaned else []
        for start in range(len(parts)):
            for root in self._roots:
                if (found := self._find_in(root, parts[start:])) is not None:
                    return found
        return None

    def find_all(self, names: Sequence[str]) -> list[Path | None]:
        """`find` of each; None as well for different names that lead to one file, unless it has that very name."""
        found = [self.find(name) for name in names]
        claims = Counter(
            path for path, _ in {(path, clean_name(name)) for path, name in zip(found, names, strict=True)}
        )
        return [
            path if path is None or claims[path] == 1 or path.as_posix().endswith("/" + clean_name(name)) else None
            for path, name in zip(found, names, strict=True)
        ]

    def _find_in(self, root: Path, parts: Sequence[str]) -> Path | None:
        folders = [root]
        for part in parts[:-1]:
            folders = [
                child for folder in folders for child in self._list(folder).get(_key(part), ()) if child.is_dir()
            ]
        matches: list[Callable[[str], bool]] = [
            lambda entry: entry == _key(parts[-1]),
            lambda entry: (
                without_suffix(entry) == without_suffix(_key(parts[-1])) and entry.endswith(tuple(self._suffixes))
            ),
        ]
        for matches_name in matches:
            files = [
                path
                for folder in folders
                for key, paths in self._list(folder).items()
                if matches_name(key)
                for path in paths
                if path.is_file()
            ]
            if files:
                return _only(files, self._suffixes)
        return None

    def _list(self, folder: Path) -> dict[str, list[Path]]:
        """The visible entries of a folder by the key of their names."""
        if folder not in self._listings:
            listing: dict[str, list[Path]] = {}
            try:
                entries = sorted(folder.iterdir())
            except OSError:
                entries = []
            for entry in entries:
                if not is_hidden(entry):
                    listing.setdefault(_key(entry.name), []).append(entry)
            self._listings[folder] = listing
        return self._listings[folder]


def find_masks(folder: Path, names: Sequence[str]) -> list[Path | None]:
    """The masks of pictures in a folder of masks: NAME.png as COLMAP calls its own, NAME with any suffix, or NAME_mask.png."""
    finder = FileFinder(folder, suffixes=MASK_SUFFIXES)
    found: list[Path | None] = [None] * len(names)
    for pattern in ("{name}.png", "{name}", "{stem}_mask.png"):
        masks = finder.find_all([pattern.format(name=name, stem=without_suffix(name)) for name in names])
        found = [known or mask for known, mask in zip(found, masks, strict=True)]
    return found


def _only(files: list[Path], suffixes: Sequence[str]) -> Path | None:
    """The file with the first of the suffixes; None where two have it."""
    rank = [suffixes.index(p.suffix.lower()) if p.suffix.lower() in suffixes else len(suffixes) for p in files]
    best = [path for path, r in zip(files, rank, strict=True) if r == min(rank)]
    return best[0] if len(best) == 1 else None


def _key(name: str) -> str:
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _suffix(name: str) -> str:
    suffix = PurePosixPath(name).suffix
    return suffix if suffix.lower() in (*PICTURE_SUFFIXES, *UNREAD_FORMATS) else ""
