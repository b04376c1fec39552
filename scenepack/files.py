"""The files of a pack, read in place from a folder or from one .zip of that folder.

A zip may hold the files at its root or inside one top folder. Nothing is ever extracted to disk.
"""

from __future__ import annotations

import lzma
import struct
import threading
import zipfile
import zlib
from abc import ABC, abstractmethod
from pathlib import Path

from console import UserError
from scenepack.other_formats import refuse_other_file, refuse_other_names

PARAMS_NAME = "scene_params.json"
INDICES_NAME = "atlas_indices.png"

# What zipfile raises on damaged or unreadable archives, beside OSError; RuntimeError for encrypted ones.
ZIP_ERRORS = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, IndexError, NotImplementedError, RuntimeError,
    OverflowError, ValueError,
)  # fmt: skip


class PackFiles(ABC):
    """Files by name. Reading is safe from several threads; errors are UserError."""

    path: Path
    sizes: dict[str, int]  # bytes of each file, as read
    stored_bytes: int  # what the pack takes on disk

    def read(self, name: str, most: int) -> bytes:
        """A whole file; UserError where it is missing or holds more than `most` bytes."""
        data = self._bytes(name, most + 1, to_end=True)
        if len(data) > most:
            raise UserError("is too large", where=f"{self.path}: {name}", expected=f"at most {most} bytes")
        return data

    def head(self, name: str, count: int) -> bytes:
        """The first `count` bytes of a file, or fewer where it ends."""
        return self._bytes(name, count, to_end=False)

    @abstractmethod
    def _bytes(self, name: str, count: int, *, to_end: bool) -> bytes:
        """The first `count` bytes. to_end: the file is read as a whole if it has no more."""

    def close(self) -> None:
        return


def open_files(path: Path) -> PackFiles:
    """The files of the pack at `path`. UserError where no folder or readable zip holds one."""
    path = Path(path)
    try:
        if path.is_dir():
            files: PackFiles = FolderFiles(path)
        elif path.is_file():
            refuse_other_file(path)
            files = ZipFiles(path)
        else:
            what = "is neither a folder nor a file" if path.exists() else "does not exist"
            raise UserError(what, where=path, expected="the folder or .zip of a pack", remedy="check the path")
    except OSError as error:
        raise UserError(f"cannot be read: {error.strerror or error}", where=path) from error
    if PARAMS_NAME not in files.sizes:
        files.close()
        refuse_other_names(path, files.sizes)
        raise _not_a_pack(path, list(files.sizes))
    return files


def _not_a_pack(path: Path, names: list[str]) -> UserError:
    inner = sorted(p.parent.name for p in path.glob(f"*/{PARAMS_NAME}")) if path.is_dir() else []
    if inner:
        return UserError(
            f"is not a pack, but contains {len(inner)}", where=path, remedy=f"open {path / inner[0]} instead"
        )
    if not names:
        folders = sorted(p.name for p in path.glob("*/")) if path.is_dir() else []
        found = f"only folders, such as {folders[0]}" if folders else None
        return UserError(
            "holds no files" if folders else "is empty", where=path, expected=f"a pack with {PARAMS_NAME}", found=found
        )
    return UserError(
        f"is not a pack: it has no {PARAMS_NAME}",
        where=path,
        found=f"{len(names)} other files, such as {min(names)}",
        remedy="name the folder or .zip that snerg-bake wrote",
    )


class FolderFiles(PackFiles):
    """A pack as a folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sizes = {entry.name: entry.stat().st_size for entry in path.iterdir() if entry.is_file()}
        self.stored_bytes = sum(self.sizes.values())

    def _bytes(self, name: str, count: int, *, to_end: bool) -> bytes:
        if name not in self.sizes:  # also where it is a pipe, whose writer we would wait for
            raise UserError("is missing", where=self.path / name)
        try:
            if not (self.path / name).is_file():  # a pipe would be waited for
                raise UserError("is missing", where=self.path / name)
            with open(self.path / name, "rb") as file:
                return file.read(count)
        except OSError as error:
            raise UserError(f"cannot be read: {error.strerror or error}", where=self.path / name) from error


class ZipFiles(PackFiles):
    """A pack as one .zip."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._zip = zipfile.ZipFile(path)
        except ZIP_ERRORS as error:
            raise UserError(
                "cannot be opened as a .zip",
                where=path,
                found=str(error) or type(error).__name__,
                remedy="the file may be damaged or incomplete; copy it again",
            ) from error
        self._lock = threading.Lock()  # one file handle, one reader at a time
        entries = {
            info.filename.replace("\\", "/").removeprefix("./"): info
            for info in self._zip.infolist()
            if info.filename and not info.is_dir() and "__MACOSX" not in info.filename
        }
        tops = {name.rpartition("/")[0] for name in entries if name.rpartition("/")[2] == PARAMS_NAME}
        tops = {top for top in tops if "/" not in top}
        if "" in tops:
            tops = {""}
        if len(tops) > 1:
            self.close()
            raise UserError(f"holds {len(tops)} packs", where=path, remedy="make a .zip of a single pack")
        top = tops.pop() + "/" if tops and "" not in tops else ""
        self._entries = {
            name.removeprefix(top): info
            for name, info in entries.items()
            if name.startswith(top) and (not top or "/" not in name.removeprefix(top))
        }
        self.sizes = {name: info.file_size for name, info in self._entries.items()}
        self.stored_bytes = path.stat().st_size

    def _bytes(self, name: str, count: int, *, to_end: bool) -> bytes:
        where = f"{self.path}: {name}"
        if name not in self._entries:
            raise UserError("is missing", where=where)
        try:
            with self._lock, self._zip.open(self._entries[name]) as file:
                data = file.read(count)
                # The checksum is compared only once the end is reached.
                if to_end:
                    file.read(1)
                return data
        except (*ZIP_ERRORS, OSError) as error:
            raise UserError(
                "cannot be read from the .zip",
                where=where,
                found=str(error) or type(error).__name__,
                remedy="the .zip may be damaged; copy it again",
            ) from error

    def close(self) -> None:
        self._zip.close()
