"""Checkpoints of a run: checkpoints/step_%08d.safetensors, written aside and renamed, the last two kept.

A file holds the arrays of Method.save, and in its metadata the step and a checksum of the arrays. Where the newest file is
damaged, the one before it is read, with a notice. The leaves of a tree are named by their paths, "params/fine/field/0/weight".
"""

import errno
import json
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr, tree_leaves_with_path
from safetensors import SafetensorError, safe_open

from console import UserError
from console.atomic import write_file
from training.scenes.files import notice

KEPT = 2
FORMAT = "1"
NAME = re.compile(r"step_(\d{8,})\.safetensors")
Tree = TypeVar("Tree")


def named_leaves(tree: Any) -> dict[str, Any]:
    return {keystr(path, simple=True, separator="/"): leaf for path, leaf in tree_leaves_with_path(tree)}


def to_arrays(tree: Any) -> dict[str, np.ndarray]:
    """Copies a tree's leaves to the host, by name."""
    return {name: np.asarray(leaf) for name, leaf in jax.device_get(named_leaves(tree)).items()}


def from_arrays(template: Tree, arrays: Mapping[str, np.ndarray]) -> Tree:
    """The tree of a template's structure (of arrays or of jax.ShapeDtypeStruct) with the named arrays as leaves, on the device.

    UserError where a name is missing, or an array's shape or type is another.
    """
    leaves = []
    for name, wanted in named_leaves(template).items():
        expected, found = type_and_shape(wanted), type_and_shape(arrays.get(name))
        if expected != found:
            raise misfit(name, expected, found)
        leaves.append(jnp.asarray(arrays[name]))
    return jax.tree.unflatten(jax.tree.structure(template), leaves)


def type_and_shape(array: Any) -> str:
    """Type and shape of an array as text for messages."""
    return "none" if array is None else f"{array.dtype} {list(array.shape)}"


def misfit(name: str, expected: str, found: str) -> UserError:
    """The error for an array of a checkpoint that does not fit the run."""
    remedy = "the file is damaged, or belongs to another run or other photographs"
    return UserError(f'array "{name}" does not fit', where="checkpoint", expected=expected, found=found, remedy=remedy)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns an OSError met while writing `path` into a UserError."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        what, remedy = ("the disk is full", "free some space") if full else ("cannot be written", "make it writable")
        remedy += ", then continue with --resume"
        raise UserError(what, where=path, found=error.strerror, remedy=remedy) from error


def list_checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """(step, path) of every finished checkpoint, oldest first."""
    matches = [(NAME.fullmatch(path.name), path) for path in folder.glob("*")]
    # a pipe is no file: opening it would wait for its writer
    return sorted((int(match[1]), path) for match, path in matches if match and path.is_file())


def write_checkpoint(folder: Path, step: int, arrays: Mapping[str, np.ndarray]) -> Path:
    """Writes the state after `step` steps and drops all but the newest KEPT checkpoints. UserError where it cannot be written."""
    metadata = {"format": FORMAT, "step": str(step), "crc32": checksum(arrays)}
    path = folder / f"step_{step:08d}.safetensors"
    with writing(path):
        folder.mkdir(parents=True, exist_ok=True)
        write_file(path, _serialised(arrays, metadata))
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
    if metadata.get("crc32") != checksum(arrays):
        raise UserError("the checkpoint is damaged", where=path, found="a checksum that does not match")
    return int(metadata["step"]), arrays


def read_newest_checkpoint(folder: Path) -> tuple[int, dict[str, np.ndarray]]:
    """(step, arrays) of the newest readable checkpoint, with a notice of damaged ones. UserError where none can be read."""
    checkpoints = list_checkpoints(folder)
    if not checkpoints:
        raise UserError("no checkpoint", where=folder, remedy="train the run first: snerg-train SCENE --out RUN")
    damage = None
    for _, path in reversed(checkpoints):
        try:
            return read_checkpoint(path)
        except UserError as error:
            notice(None, f"{error}; going back to the checkpoint before it")
            damage = damage or error
    remedy = "train the run again into another folder"
    raise UserError("no checkpoint can be read", where=folder, found=damage, remedy=remedy)


def checksum(arrays: Mapping[str, np.ndarray]) -> str:
    """CRC-32 of the names and contents of arrays, whatever their order, in hexadecimal."""
    crc = 0
    for name in sorted(arrays):
        crc = zlib.crc32(_bytes_of(arrays[name]), zlib.crc32(name.encode(), crc))
    return f"{crc:08x}"


def _bytes_of(array: np.ndarray) -> memoryview:
    """uint8 [.], in place where the array is contiguous."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def _serialised(arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> Iterator[bytes | memoryview]:
    """The parts of a safetensors file. The package's own writer copies all arrays before it writes: gigabytes of a fine grid."""
    names = sorted(arrays, key=lambda name: (-arrays[name].dtype.itemsize, name))  # so that each is aligned
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    offset = 0
    for name in names:
        array = arrays[name]
        span = [offset, offset + array.nbytes]
        dtype = array.dtype.name.upper().replace("FLOAT", "F").replace("INT", "I").replace("UI", "U")  # F32, BF16, U8
        header[name] = {"dtype": dtype, "shape": list(array.shape), "data_offsets": span}
        offset += array.nbytes
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    yield struct.pack("<Q", len(text)) + text
    for name in names:
        yield _bytes_of(arrays[name])
