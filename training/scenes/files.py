"""Files of a scene: which are photographs, and where those are that a description names, however the disk spells them; messages.

Descriptions travel between systems and programs, which change slashes, case, accents, suffixes and the folders in front. A file
is found by the strictest rule that leads to one file alone:

    1. the name as it stands
    2. the same name in normal form: "/" between parts, no "." parts, Unicode composed (NFC), case folded
    3. the same, with another suffix of a picture, or none
    4. 2 and 3 without leading folders of the name, one after the other
"""

import contextlib
import itertools
import os
import unicodedata
from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath

from console import Notice, notify

READ_PICTURES = "PNG, JPEG, WebP, TIFF, BMP, AVIF, HEIC, JPEG XL, JPEG 2000, OpenEXR or Radiance HDR"
PICTURE_SUFFIXES = (
    ".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".webp", ".tif", ".tiff", ".bmp", ".avif", ".heic", ".heif", ".hif",
    ".jxl", ".jp2", ".j2k", ".exr", ".hdr",
)  # fmt: skip
RAW = "dng cr2 cr3 crw nef nrw arw sr2 srf raf orf rw2 pef srw x3f 3fr iiq rwl gpr fff erf kdc dcr mos mrw raw"
OTHERS = "gif jpx jpf jxr psd psb xcf svg ico tga dds ppm pgm pnm pbm pfm qoi ktx2"
UNSTITCHED = "insp insv 360"  # of cameras with two lenses
# What to do with photographs of formats that are not read, by suffix.
UNREAD_FORMATS = {f".{suffix}": "export them as JPEG, PNG or 16 bit TIFF" for suffix in RAW.split()}
UNREAD_FORMATS |= {f".{suffix}": "convert them to JPEG or PNG" for suffix in OTHERS.split()}
UNREAD_FORMATS |= {
    f".{suffix}": "export panoramas (360°, equirectangular) as JPEG or MP4" for suffix in UNSTITCHED.split()
}
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
    suffix = PurePosixPath(name).suffix
    return name.removesuffix(suffix) if suffix.lower() in (*PICTURE_SUFFIXES, *UNREAD_FORMATS) else name


def distinct(stems: Sequence[str]) -> list[str]:
    """The stems of a.png and a.jpg as a and a-2: repeated ones get a number. Case does not count, as in some file systems."""
    found: dict[str, str] = {}  # by lower case
    for stem in stems:
        numbered = (f"{stem}-{number}" for number in itertools.count(2))
        free = next(one for one in itertools.chain([stem], numbered) if one.lower() not in found)
        found[free.lower()] = free
    return list(found.values())


def is_hidden(path: Path) -> bool:
    """Whether a file or a folder is the system's own, by its name: ._IMG_1.jpg, __MACOSX, Thumbs.db."""
    return path.name.startswith(".") or path.name.lower() in SYSTEM_FILES


def visible_files(folder: Path, suffixes: Collection[str] = PICTURE_SUFFIXES) -> list[Path]:
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
        parts = [part for part in clean_name(name).split("/") if part]
        tries = (self._find_in(root, parts[start:]) for start in range(len(parts)) for root in self._roots)
        return next((found for found in tries if found is not None), None)

    def find_all(self, names: Sequence[str]) -> list[Path | None]:
        """`find` of each; None as well for different names that lead to one file, unless it has that very name."""
        found = [(self.find(name), clean_name(name)) for name in names]
        claims = Counter(path for path, _ in {*found})
        return [
            path if path is None or claims[path] == 1 or path.as_posix().endswith("/" + name) else None
            for path, name in found
        ]

    def _find_in(self, root: Path, parts: Sequence[str]) -> Path | None:
        """The file with the first suffix of those that have a name; None where there is none, or several have it."""
        folders = [root]
        for part in parts[:-1]:
            below = [child for folder in folders for child in self._alike(folder, part)]
            folders = [child for child in below if _key(child.name) == _key(part) and child.is_dir()]
        alike = [path for folder in folders for path in self._alike(folder, parts[-1]) if path.is_file()]
        same = [path for path in alike if _key(path.name) == _key(parts[-1])]
        files = same or [path for path in alike if path.suffix.lower() in self._suffixes]
        ranks = [(*self._suffixes, path.suffix.lower()).index(path.suffix.lower()) for path in files]
        best = [path for path, rank in zip(files, ranks, strict=True) if rank == min(ranks)]
        return best[0] if len(best) == 1 else None

    def _alike(self, folder: Path, name: str) -> list[Path]:
        """The visible entries of a folder that have a name, whatever their suffix."""
        if folder not in self._listings:
            listing = self._listings[folder] = {}
            with contextlib.suppress(OSError):
                for entry in sorted(folder.iterdir()):
                    if not is_hidden(entry):
                        listing.setdefault(without_suffix(_key(entry.name)), []).append(entry)
        return self._listings[folder].get(without_suffix(_key(name)), [])


def find_masks(folder: Path, names: Sequence[str]) -> list[Path | None]:
    """The masks of pictures in a folder of masks: NAME.png as COLMAP calls its own, NAME with any suffix, or NAME_mask.png."""
    finder = FileFinder(folder, suffixes=MASK_SUFFIXES)
    found: list[Path | None] = [None] * len(names)
    for pattern in ("{name}.png", "{name}", "{stem}_mask.png"):
        masks = finder.find_all([pattern.format(name=name, stem=without_suffix(name)) for name in names])
        found = [known or mask for known, mask in zip(found, masks, strict=True)]
    return found


def _key(name: str) -> str:
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


NAMED = 8  # names in a message


def notice(where: Path | str | None, text: str, names: Sequence[str] | None = None) -> None:
    """Warns of what was left out or repaired, with the first of the `names` that it concerns; not where there are none."""
    if names is not None and not names:
        return
    words = text if where is None else f"{where}: {text}"
    notify(Notice(f"{words} ({few(names)})" if names else words), stacklevel=3)


def few(names: Sequence[str]) -> str:
    """The first NAMED of some names; where there are more, how many."""
    return ", ".join(names[:NAMED]) + (f", … ({len(names)} in all)" if len(names) > NAMED else "")


def times(size: Sequence[int]) -> str:
    """A size, (width, height) in pixels."""
    return f"{size[0]}x{size[1]}"
