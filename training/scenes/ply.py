"""The vertices of a PLY file: places alone, ASCII or binary. UserError for anything else, whatever the header claims."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from console import UserError

MOST_BYTES = 1 << 30
MOST_HEADER = 1 << 16
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "float64": "f8",
}  # fmt: skip
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}


def read_ply(path: Path) -> np.ndarray:
    """The finite places float64 [M, 3] of the element "vertex", which must come first."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise _damaged(path, f"more than {MOST_BYTES >> 20} MiB")
        data = path.read_bytes()
    except OSError as error:
        raise UserError("cannot be read", where=path, found=str(error)) from error
    end = data.find(b"end_header", 0, MOST_HEADER)
    body = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or not body:
        raise _damaged(path, "no header")
    lines = [line.split() for line in data[:end].decode("ascii", errors="replace").splitlines()]
    form = next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), "")
    starts = [index for index, line in enumerate(lines) if line[:1] == ["element"]]
    begin, end = [*starts, len(lines), len(lines)][:2]
    first = lines[begin] if starts else []
    properties = [line for line in lines[begin:end] if line[:1] == ["property"]]
    names = [line[-1] for line in properties]
    sound = len(first) == 3 and first[1] == "vertex" and first[2].isdigit() and form in ORDERS
    if not sound or any(len(line) != 3 or line[1] not in TYPES for line in properties) or not {*"xyz"} <= {*names}:
        raise _damaged(path, "no vertices with x, y and z")
    count = int(first[2])
    if form == "ascii":
        try:
            words = [line.split() for line in data[body:].splitlines()[:count]]
            rows = np.array(words, np.float64).reshape(-1, len(names))
        except ValueError:
            raise _damaged(path, "a line that is no list of numbers") from None
        places = rows[:, [names.index(axis) for axis in "xyz"]]
    else:
        dtype = np.dtype([(f"{i}", ORDERS[form] + TYPES[line[1]]) for i, line in enumerate(properties)])
        if count * dtype.itemsize > len(data) - body:
            raise _damaged(path, "it ends too early")
        rows = np.frombuffer(data, dtype, count, body)
        places = np.stack([rows[f"{names.index(axis)}"].astype(np.float64) for axis in "xyz"], axis=-1)
    return places[np.isfinite(places).all(-1)]


def _damaged(path: Path, found: str) -> UserError:
    return UserError("not a PLY file of points, or a damaged one", where=path, found=found)
