"""Checkpoints of a run: checkpoints/step_%08d.safetensors, written aside and renamed, the last two kept.

A file holds the arrays that Method.save named, and in its metadata the step and a checksum of the arrays.
A reader that finds the newest damaged goes back to the one before it, and says so.
"""

from __future__ import annotations

import errno
import json
import re
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from console import Notice, UserError
from console.atomic import write_file

KEPT = 2
DTYPES = {
    "float64": "F64", "float32": "F32", "float16": "F16", "bfloat16": "BF16", "int64": "I64", "int32": "I32", "int16": "I16",
    "int8": "I8", "uint64": "U64", "uint32": "U32", "uint16": "U16", "uint8": "U8", "bool": "BOOL",
}  # fmt: skip
FORMAT = "1"
NAME = re.compile(r"step_(\d{8,})\.safetensors")


def checkpoint_path(folder: Path, step: int) -> Path:
    """Where the checkpoint after `step` steps lies in a run's checkpoints folder."""
    return folder / f"step_{step:08d}.safetensors"


def list_checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """(step, path) of every finished checkpoint, oldest first."""
    found = []
    for path in folder.glob("step_*.safetensors") if folder.is_dir() else ():
        match = NAME.fullmatch(path.name)
        if match and path.is_file():  # opening a pipe would wait for its writer
            found.append((int(match.group(1)), path))
    return sorted(found)


def write_checkpoint(folder: Path, step: int, arrays: Mapping[str, np.ndarray]) -> Path:
    """Writes the state after `step` steps and drops all but the newest KEPT checkpoints.

    A killed writer leaves the old checkpoints and at most a temporary file. UserError where the disk is
    full or the folder cannot be written; no temporary file stays then.
    """
    arrays = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    metadata = {"format": FORMAT, "step": str(step), "crc32": _checksum(arrays)}
    path = checkpoint_path(folder, step)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_file(path, _serialised(arrays, metadata))
    except OSError as error:
        raise cannot_write(path, error) from error
    for _, old in list_checkpoints(folder)[:-KEPT]:
        old.unlink(missing_ok=True)
    return path


def read_checkpoint(path: Path) -> tuple[int, dict[str, np.ndarray]]:
    """(step, arrays) of a checkpoint. UserError where it is damaged or none of ours."""
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, KeyError) as error:
        raise UserError("the checkpoint is damaged", where=path, found=str(error)[:100]) from error
    if metadata.get("format") != FORMAT or not metadata.get("step", "").isdigit():
        raise UserError("not a checkpoint of this version of snerg", where=path)
    if metadata.get("crc32") != _checksum(arrays):
        raise UserError("the checkpoint is damaged", where=path, found="a checksum that does not match")
    return int(metadata["step"]), arrays


def read_newest_checkpoint(folder: Path) -> tuple[int, dict[str, np.ndarray]]:
    """(step, arrays) of the newest readable checkpoint; a damaged one is passed over with a warning line.

    UserError where there is none, or none that can be read.
    """
    checkpoints = list_checkpoints(folder)
    if not checkpoints:
        raise UserError("no checkpoint", where=folder, remedy="train the run first: snerg-train SCENE --out RUN")
    damage = None
    for _, path in reversed(checkpoints):
        try:
            return read_checkpoint(path)
        except UserError as error:
            warnings.warn(Notice(f"{error}; going back to the checkpoint before it"), stacklevel=2)
            damage = damage or error
    raise UserError(
        "no checkpoint can be read",
        where=folder,
        found=damage,
        remedy="train the run again into another folder",
    )


def cannot_write(path: Path, error: OSError) -> UserError:
    """The UserError for an OSError met while writing `path`."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    remedy = "free some space, then continue with --resume" if full else "make it writable, then continue with --resume"
    return UserError(
        "the disk is full" if full else "cannot be written", where=path, found=error.strerror, remedy=remedy
    )


def _checksum(arrays: Mapping[str, np.ndarray]) -> str:
    crc = 0
    for name in sorted(arrays):
        crc = zlib.crc32(name.encode(), crc)
        crc = zlib.crc32(_bytes_of(arrays[name]), crc)
    return f"{crc:08x}"


def _bytes_of(array: np.ndarray) -> memoryview:
    """uint8 [.], in place where the array is contiguous."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def _serialised(arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> Iterator[bytes | memoryview]:
    """A safetensors file part by part: the package's own writer would hold all arrays twice more, gigabytes of a fine grid."""
    names = sorted(arrays, key=lambda name: (-arrays[name].dtype.itemsize, name))  # so that each is aligned
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    offset = 0
    for name in names:
        array = arrays[name]
        span = [offset, offset + array.nbytes]
        header[name] = {"dtype": DTYPES[array.dtype.name], "shape": list(array.shape), "data_offsets": span}
        offset += array.nbytes
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    yield struct.pack("<Q", len(text)) + text
    for name in names:
        yield _bytes_of(arrays[name])
