"""The files of a pack, read in place from a folder or from one .zip of that folder; refusal of what is no pack, or takes more
room than its bytes explain.

A zip may hold the files at its root or inside one top folder. Nothing is ever extracted to disk.
"""

import lzma
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from console import UserError
from console.memory import free_memory
from scenepack.codecs.base import CodecError

REMEDY = "snerg opens SNeRG packs; make one of the photographs: snerg-make PHOTOS --out DIR"
HEADER_BYTES = 8192  # of a .ply, in which its properties are listed
# What tells by a key of scene_params.json that it is no pack of ours; the first that is there counts.
_KEYS = {
    **dict.fromkeys(("num_local_submodels", "sm_to_params", "submodel_idx"), "a SMERF pack"),
    **dict.fromkeys(("triplane_resolution", "triplane_voxel_size"), "a MERF pack"),
    "sparse_grid_resolution": "a binary opacity grid",
}
_GAUSSIANS = "a file of 3D Gaussians"
_SUFFIXES = {
    **dict.fromkeys((".splat", ".ksplat", ".spz", ".sog"), _GAUSSIANS),
    **dict.fromkeys((".ingp", ".msgpack"), "a snapshot of instant-ngp"),
    **dict.fromkeys((".ckpt", ".pth"), "a checkpoint of another program"),
    **dict.fromkeys((".obj", ".glb", ".gltf", ".stl"), "a mesh"),
}


def refuse_other_params(raw: Mapping[str, Any], where: str) -> None:
    """UserError where a scene_params.json is another program's."""
    for key, name in _KEYS.items():
        if key in raw:
            raise UserError(f"this is {name}", where=where, found=key, remedy=REMEDY)


def refuse_other_file(path: Path) -> None:
    """UserError where the file is another program's scene. OSError where it cannot be read."""
    suffix = path.suffix.lower()
    name = _SUFFIXES.get(suffix)
    with open(path, "rb") as file:
        head = file.read(HEADER_BYTES)
    if head.startswith((b"ply\n", b"ply\r")):
        header, suffix = head.partition(b"end_header")[0], ".ply"
        name = "a mesh" if b"element face" in header else "a cloud of points"
        if b" f_dc_0" in header or b" rot_0" in header:
            name = _GAUSSIANS
    elif head.startswith(b"PK") and suffix != ".sog":
        name = None  # a .zip under another name
    if name is not None:
        raise UserError(f"this is {name} ({suffix})", where=path, remedy=REMEDY)


PARAMS_NAME = "scene_params.json"
INDICES_NAME = "atlas_indices.png"
COPY_OR_BAKE = "copy the pack again, or bake it again"  # a remedy

# What zipfile raises on damaged or unreadable archives, beside OSError; RuntimeError for encrypted ones.
ZIP_ERRORS = (
    zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, EOFError, IndexError, NotImplementedError, RuntimeError,
    OverflowError, ValueError,
)  # fmt: skip


@dataclass(frozen=True)
class PackFiles:
    """Files by name. Reading is safe from several threads; errors are UserError."""

    path: Path
    sizes: Mapping[str, int]  # bytes of each file, as read
    opened: Callable[[str], IO[bytes]]
    close: Callable[[], None] = lambda: None

    def where(self, name: str) -> str:
        """A file for messages."""
        return f"{self.path}: {name}"

    @contextmanager
    def decoding(self, name: str) -> Iterator[None]:
        """Turns a CodecError of the block into a UserError that names the codec's file, or `name` where it has none."""
        try:
            yield
        except CodecError as error:
            where = self.where(error.file or name)
            raise UserError(f"cannot be decoded: {error}", where=where, remedy=COPY_OR_BAKE) from error

    def read(self, name: str, most: int) -> bytes:
        """A whole file; UserError where it is missing or holds more than `most` bytes."""
        data = self.head(name, most + 1)
        if len(data) > most:
            raise UserError("is too large", where=self.where(name), expected=f"at most {most} bytes")
        return data

    def head(self, name: str, count: int) -> bytes:
        """The first `count` bytes of a file, or fewer where it ends; then the checksum of a .zip is compared, too."""
        if name not in self.sizes:
            raise UserError("is missing", where=self.where(name))
        try:
            with self.opened(name) as file:
                return file.read(count)
        except (*ZIP_ERRORS, OSError) as error:
            found = (error.strerror if isinstance(error, OSError) else str(error)) or type(error).__name__
            raise UserError("cannot be read", where=self.where(name), found=found,
                            remedy="it may be damaged; copy it again") from error  # fmt: skip


def open_files(path: Path) -> PackFiles:
    """The files of the pack at `path`. UserError where no folder or readable zip holds one."""
    try:
        if path.is_dir():
            sizes = {entry.name: entry.stat().st_size for entry in path.iterdir() if entry.is_file()}
            files = PackFiles(path, sizes, lambda name: (path / name).open("rb"))
        elif path.is_file():
            refuse_other_file(path)
            files = _in_zip(path)
        else:
            what = "is neither a folder nor a file" if path.exists() else "does not exist"
            raise UserError(what, where=path, expected="the folder or .zip of a pack", remedy="check the path")
    except OSError as error:
        raise UserError(f"cannot be read: {error.strerror or error}", where=path) from error
    if PARAMS_NAME not in files.sizes:
        files.close()
        raise _not_a_pack(path, list(files.sizes))
    return files


def _not_a_pack(path: Path, names: list[str]) -> UserError:
    inner = sorted(path.glob(f"*/{PARAMS_NAME}")) if path.is_dir() else []
    if inner:
        what, remedy = f"is not a pack, but contains {len(inner)}", f"open {inner[0].parent} instead"
        return UserError(what, where=path, remedy=remedy)
    found = f"{len(names)} other files, such as {min(names)}" if names else "no files"
    return UserError(f"is not a pack: it has no {PARAMS_NAME}", where=path, found=found,
                     remedy="name the folder or .zip that snerg-bake wrote")  # fmt: skip


def stored_bytes(path: Path) -> int:
    """What a pack takes on disk."""
    return path.stat().st_size if path.is_file() else sum(f.stat().st_size for f in path.iterdir() if f.is_file())


def _in_zip(path: Path) -> PackFiles:
    try:
        archive = zipfile.ZipFile(path)
    except ZIP_ERRORS as error:
        found, remedy = str(error) or type(error).__name__, "the file may be damaged or incomplete; copy it again"
        raise UserError("cannot be opened as a .zip", where=path, found=found, remedy=remedy) from error
    infos = [i for i in archive.infolist() if i.filename and not i.is_dir() and "__MACOSX" not in i.filename]
    every = {info.filename.replace("\\", "/").removeprefix("./"): info for info in infos}
    at_top = re.compile(rf"([^/]*/)?{re.escape(PARAMS_NAME)}")
    tops = sorted(name.removesuffix(PARAMS_NAME) for name in every if at_top.fullmatch(name))
    top = tops[0] if tops else ""  # the root, which is "", where a pack lies there
    if top and len(tops) > 1:
        archive.close()
        raise UserError(f"holds {len(tops)} packs", where=path, remedy="make a .zip of a single pack")
    inside = {name.removeprefix(top): info for name, info in every.items() if name.startswith(top)}
    entries = {name: info for name, info in inside.items() if not top or "/" not in name}
    sizes = {name: info.file_size for name, info in entries.items()}
    return PackFiles(path, sizes, lambda name: archive.open(entries[name]), archive.close)


# --- Limits -----------------------------------------------------------------------------------------------------------

# What opening a pack may take, asked before anything is allocated: a few bytes can claim gigabytes.
SHARED_FREELY, SHARED_AT_MOST = 4096, 16  # macroblocks; more of them to an atlas block make no scene
# Voxels that an atlas may have whatever is in use, and how many for each in use: bakers fill theirs to the last rows.
EMPTY_FREELY, EMPTY_AT_MOST = 1 << 26, 16


def require_memory(needed: int, where: object) -> None:
    """UserError where so many bytes are more than is free."""
    free = free_memory()
    if free is not None and needed > free:
        raise UserError("its atlas does not fit in memory", where=str(where), found=f"{needed / 1e9:.1f} GB",
                        expected=f"at most {free / 1e9:.1f} GB, which are free",
                        remedy="close other programs, or bake it at a lower resolution")  # fmt: skip


def require_filled(atlas_size: tuple[int, int, int], used: int, where: str) -> None:
    """UserError where an atlas is large and almost none of it is in use: a small file would take much memory.

    used: voxels of the macroblocks in use, padding included.
    """
    held = math.prod(atlas_size)
    if held > max(EMPTY_FREELY, EMPTY_AT_MOST * used):
        expected = f"about {used:,} voxels, those of the macroblocks in use"
        raise UserError("the atlas is far larger than its content", where=where, expected=expected, found=f"{held:,}",
                        remedy=COPY_OR_BAKE)  # fmt: skip


def require_distinct(used: np.ndarray, where: str) -> None:
    """UserError where far more macroblocks than atlas blocks make work and memory that the pack's bytes do not explain: each
    macroblock takes a place of its own on the graphics card.

    used: uint8 [n, 3], the atlas block of each macroblock.
    """
    distinct = len(np.unique(used.astype(np.uint32) @ np.array([1, 256, 65536], np.uint32)))
    if len(used) > SHARED_FREELY + SHARED_AT_MOST * distinct:
        expected = f"about one each, and at most {SHARED_AT_MOST} to a block"
        raise UserError(f"{len(used)} macroblocks share {distinct} blocks of the atlas", where=where, expected=expected,
                        remedy=COPY_OR_BAKE)  # fmt: skip
