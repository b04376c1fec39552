"""What lies in a folder without poses, by names and a film's first bytes: photographs, or a film. Nothing is decoded.

A film is opened with the one FFmpeg demuxer that its first bytes name. FFmpeg's own guess knows playlists and lists of files,
which lead to other files and to the network; none of the demuxers here does.
"""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from console import UserError
from console.file_signature import HEAD_BYTES, sniff_type
from training.scenes import files, llff, programs
from training.scenes.read import has_poses

FILM_HEAD_BYTES = 1024  # of a film that tell its container
# QuickTime may begin with any of these boxes. Brands of stills (HEIC, AVIF, CR3) are none of films.
MP4 = rb".{4}(moov|mdat|wide|free|skip|ftyp(?!avif|avis|heic|heix|hevc|heim|heis|mif1|msf1|jxl |crx ))"
# Packets of 188 bytes begin with G; cameras (M2TS, MTS) put a time of 4 bytes before each.
TRANSPORT_STREAM = rb"G(.{187}G){3}|.{4}G(.{191}G){3}|G(.{203}G){3}"


@dataclass(frozen=True)
class Container:
    name: str  # for messages
    demuxer: str  # FFmpeg's
    suffixes: tuple[str, ...]
    mime_types: tuple[str, ...]
    signature: bytes  # regular expression of its first FILM_HEAD_BYTES


CONTAINERS = (
    Container("MP4, MOV, 3GP", "mp4", (".mp4", ".m4v", ".mov", ".qt", ".3gp", ".3g2"),
              ("video/mp4", "video/quicktime", "video/3gpp", "video/3gpp2"), MP4),
    Container("WebM, Matroska", "matroska", (".webm", ".mkv"), ("video/webm", "video/x-matroska"), b"\x1a\x45\xdf\xa3"),
    Container("AVI", "avi", (".avi", ".divx"), ("video/x-msvideo",), b"RIFF.{4}AVI[ X]"),
    Container("MTS", "mpegts", (".ts", ".mts", ".m2ts", ".m2t"), ("video/mp2t",), TRANSPORT_STREAM),
    Container("MPEG", "mpeg", (".mpg", ".mpeg", ".vob"), ("video/mpeg",), b"\0\0\1\xba"),
    Container("WMV", "asf", (".wmv", ".asf"), ("video/x-ms-wmv", "video/x-ms-asf"), b"\x30\x26\xb2\x75\x8e\x66\xcf\x11"),
    Container("FLV", "flv", (".flv", ".f4v"), ("video/x-flv",), b"FLV\1"),
    Container("Ogg", "ogg", (".ogv", ".ogm"), ("video/ogg",), b"OggS"),
)  # fmt: skip
FILMS = tuple(suffix for container in CONTAINERS for suffix in container.suffixes)
FILM_NAMES = ", ".join(container.name for container in CONTAINERS)  # for messages
DEMUXERS = ",".join(["mov", "webm", *(container.demuxer for container in CONTAINERS)])  # as FFmpeg's format_whitelist

FEWEST = 8  # pictures that must have a pose in the end; of fewer no scene can come
PHOTOGRAPHS = f"a folder of photographs ({files.READ_PICTURES}), at least {FEWEST} or with camera poses"
READ = f"{PHOTOGRAPHS}, or a film ({FILM_NAMES})"
SUBFOLDER = "images"  # where other programs keep a scene's pictures
UNPACK = "unpack the archive, and name the folder"
MAPS = ("depth", "depths", "conf", "confidence", "normals")  # folders of pictures that are no photographs, beside these
MASKS = "masks"  # beside the photographs, or beside the folder SUBFOLDER that they are in


@dataclass(frozen=True)
class Source:
    kind: Literal["photographs", "film"]
    path: Path  # the folder or the film, as it was named
    files: tuple[Path, ...]  # the pictures in the order of their names; or the one film
    notes: tuple[str, ...] = ()  # what else lies there and is not used, a line each

    @property
    def folder(self) -> Path:
        """What the names of `files` are relative to."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def masks(self) -> Path | None:
        """The folder of masks beside the photographs; None where there is none."""
        beside = [self.path] + ([self.path.parent] if self.path.name == SUBFOLDER else [])
        folders = (folder / MASKS for folder in beside if self.kind == "photographs")
        return next((folder for folder in folders if folder.is_dir()), None)

    def mask_of(self, file: Path) -> Path | None:
        """The mask of a photograph, by its name within the source, or else by its own; None where there is none."""
        folder = self.masks
        if folder is None:
            return None
        within = file.relative_to(self.folder).as_posix().removeprefix(f"{SUBFOLDER}/")
        return next((mask for mask in files.find_masks(folder, [within, file.name]) if mask is not None), None)

    def name_of(self, file: Path) -> str:
        """A file's name for messages; bytes that are not UTF-8 as \\xe4."""
        return _readable(file.relative_to(self.folder).as_posix())


def find_source(path: Path) -> Source | None:
    """The photographs or the film at `path`, whether or not there are poses; None where there are none.

    Photographs lie in the first of these with FEWEST or more, else in the first with any: the folder itself, its `images`, the
    folders just below, those of `images`, `*/images`, `DCIM/*`; never in folders of masks or MAPS. A folder may hold one film
    instead, also beside fewer than FEWEST pictures, such as its cover. UserError for several films, for photographs of a scene
    with poses in a folder below, and for a folder or its `images` with pictures of formats that are not read alone.
    """
    if os.path.isfile(path):
        readable = is_film(path) or (path.suffix.lower() not in files.UNREAD_FORMATS and container_of(path) is not None)
        return Source("film", path, (path,)) if readable else None
    if not os.path.isdir(path):
        return None
    found, unread, passed_over = _pictures(path)
    films = sorted(file for file in path.iterdir() if is_film(file))
    notes = [f"{_formats(unread)}, a format that is not read; {_remedies(unread)}"] if unread else []
    if passed_over:
        notes.append(f"the {len(found)} pictures in folders below are used, not {_named(passed_over)}")
    if len(found) < FEWEST and films:
        if len(films) > 1:
            also = f"only {len(found)}" if found else "no"
            raise UserError(f"several films, and {also} photographs", where=path, expected="one film",
                            found=_named(films), remedy="name one of them")  # fmt: skip
        if found:
            beside = _readable(found[0].name) if len(found) == 1 else f"the {len(found)} pictures"
            notes.append(f"{_readable(films[0].name)} is used, not {beside} beside it")
        return Source("film", path, (films[0],), tuple(notes))
    if found:
        _require_no_scene_below(path, found[0])
        return Source("photographs", path, tuple(sorted(found, key=lambda file: in_order(str(file)))), tuple(notes))
    if any(file.parent in (path, path / SUBFOLDER) for file in unread):
        raise _none_is_read(path, unread)
    return None


def require_source(path: Path) -> Source:
    """The same. UserError, with what is there and what is read, where there are neither photographs nor a film."""
    source = find_source(path)
    if source is not None and (source.kind == "photographs" or container_of(source.files[0]) is not None):
        return source
    if not os.path.lexists(path):
        raise UserError("no such file or folder", where=path, expected=READ)
    file = path if source is None else source.files[0]
    if os.path.isfile(file):
        with file.open("rb") as opened:
            found = sniff_type(opened.read(HEAD_BYTES))
        of_scene = file.suffix.lower() in (*files.PICTURE_SUFFIXES, ".json", ".npy", ".bin")
        remedies = {found == "a ZIP archive": UNPACK, of_scene: "name the folder that it is in"}
        raise UserError("not a film that can be read", where=file, expected=READ, found=found,
                        remedy=remedies.get(True, files.UNREAD_FORMATS.get(file.suffix.lower())))  # fmt: skip
    if not os.path.isdir(path):
        raise UserError("neither a file nor a folder", where=path, expected=READ)
    if unread := _pictures(path)[1]:
        raise _none_is_read(path, unread)
    entries = sorted(entry for entry in path.iterdir() if not files.is_hidden(entry))
    if not entries:
        raise UserError("the folder is empty", where=path, expected=READ)
    raise UserError("no photographs and no film in this folder", where=path, expected=READ, found=_named(entries),
                    remedy=UNPACK if any(entry.suffix.lower() == ".zip" for entry in entries) else None)  # fmt: skip


def _pictures(path: Path) -> tuple[list[Path], list[Path], list[Path]]:
    """The pictures that find_source chooses; those up to there of formats that are not read, but for an IMG_1.DNG beside
    IMG_1.JPG; and those that were passed over."""
    found: list[Path] = []
    unread: list[Path] = []
    passed_over: list[Path] = []  # too few: a cover, say
    places = [".", SUBFOLDER, "*", f"{SUBFOLDER}/*", f"*/{SUBFOLDER}", "DCIM/*"]
    if llff.recognises(path):  # images_4 and images_8 hold the same photographs
        smaller = sorted(path.glob(f"{SUBFOLDER}_*"), key=lambda folder: in_order(folder.name))[:1]
        places = [".", SUBFOLDER, *(folder.name for folder in smaller)]
    for place in places:
        folders = [path] if place == "." else [one for one in path.glob(place) if _may_hold_pictures(path, one)]
        here = [file for folder in folders for file in _pictures_in(folder)]
        unread += [file for folder in folders for file in files.visible_files(folder, files.UNREAD_FORMATS)]
        if not found or len(here) >= FEWEST:
            passed_over, found = found, here
        if len(found) >= FEWEST:
            break
    stems = {file.with_suffix("") for file in found}
    unread = sorted({file for file in unread if file.with_suffix("") not in stems})
    return found, unread, [file for file in passed_over if file not in found]


def _pictures_in(folder: Path) -> list[Path]:
    """The pictures directly in a folder; of an export of 3D Scanner App without its depth maps, thumbnails and texture."""
    found = files.visible_files(folder)
    frames = [file for file in found if file.name.startswith("frame_")]
    return frames if frames and any(folder.glob("frame_*.json")) and programs.recognises(folder) else found


def _may_hold_pictures(path: Path, folder: Path) -> bool:
    """Whether `folder`, below `path`, is a folder that may be read, and neither it nor one above is hidden, of masks or MAPS."""
    parts = folder.relative_to(path).parts
    is_open = folder.is_dir() and os.access(folder, os.R_OK | os.X_OK)
    return is_open and not any(p.startswith(MASKS) or p.lower() in MAPS or files.is_hidden(Path(p)) for p in parts)


def _require_no_scene_below(path: Path, picture: Path) -> None:
    """UserError where the picture is one of a scene with poses in a folder below `path`: they would not be used."""
    below = [folder for folder in picture.parents if path in folder.parents]
    if scene := next(filter(has_poses, below), None):
        raise UserError(
            "a scene with camera poses lies in a folder below", where=path, found=scene, remedy="name that folder"
        )


def _none_is_read(path: Path, unread: Sequence[Path]) -> UserError:
    return UserError("no pictures of a format that is read", where=path, expected=READ, found=_formats(unread),
                     remedy=_remedies(unread))  # fmt: skip


def container_of(film: Path) -> Container | None:
    """A film's container by its first bytes; None for any other file."""
    with film.open("rb") as file:
        head = file.read(FILM_HEAD_BYTES)
    return next((container for container in CONTAINERS if re.match(container.signature, head, re.DOTALL)), None)


def is_film(path: Path) -> bool:
    """Whether a file is named as a film that can be read."""
    return path.suffix.lower() in FILMS and not files.is_hidden(path) and os.path.isfile(path)


def in_order(name: str) -> list[tuple[int, int, str]]:
    """A key that sorts names with their numbers as numbers: IMG_9.jpg, IMG_10.jpg."""
    parts = re.split(r"(\d+)", name.lower())
    return [(0, int(part), "") if part.isascii() and part.isdigit() else (1, 0, part) for part in parts if part]


def _readable(name: str) -> str:
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def _named(paths: Sequence[Path]) -> str:
    return files.few([_readable(path.name) for path in paths])


def _formats(paths: Sequence[Path]) -> str:
    """How many there are of each format: "12 AVIF, 1 GIF pictures"."""
    counts = Counter(sorted(file.suffix[1:].upper() for file in paths))
    return ", ".join(f"{count} {name}" for name, count in counts.items()) + f" picture{'s' * (len(paths) > 1)}"


def _remedies(unread: Sequence[Path]) -> str:
    return "; ".join(sorted({files.UNREAD_FORMATS[path.suffix.lower()] for path in unread}))
