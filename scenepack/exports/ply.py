"""PLY (Turk 1994), binary and little endian: points, meshes, and Gaussians as splat viewers read them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

TYPES = {"f4": "float", "u1": "uchar"}
Column = tuple[str, str]  # name and type, "f4" or "u1"
POINT: tuple[Column, ...] = (
    *((name, "f4") for name in ("x", "y", "z", "nx", "ny", "nz")),
    *((name, "u1") for name in ("red", "green", "blue")),
)


def ply_parts(
    columns: Sequence[Column],
    values: Sequence[np.ndarray],
    faces: np.ndarray | None = None,
    comments: Sequence[str] = (),
) -> list[bytes]:
    """The file in parts. columns: of a vertex; values: one array [n, k] after the other that together fill them.

    faces: int [f, 3] or None.
    """
    count = len(values[0])
    table = np.zeros(count, [(name, f"<{kind}") for name, kind in columns])
    names = iter(columns)
    for array in values:
        for i in range(array.shape[1]):
            table[next(names)[0]] = array[:, i]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    lines += [f"element vertex {count}", *(f"property {TYPES[kind]} {name}" for name, kind in columns)]
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    parts = ["\n".join([*lines, "end_header", ""]).encode("ascii"), table.tobytes()]
    if faces is not None:
        rows = np.zeros(len(faces), [("count", "u1"), ("vertices", "<i4", 3)])
        rows["count"], rows["vertices"] = 3, faces
        parts.append(rows.tobytes())
    return parts
