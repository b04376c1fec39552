"""Files of meshes, points and Gaussians: PLY, binary glTF, SPZ.

The colours are photographed light, so nothing may light them again. COLOR_0 is linear, so they are decoded from sRGB, into 16
bits: 8 would show bands in the dark.

One round Gaussian for each voxel, in its diffuse colour (f_dc only). Viewers splat a Gaussian as o g(d): its opacity o, and
g(d) = exp(-d^2 / 2 s^2) at distance d of the ray. So that a plane of voxels of opacity a lets as much pass as the pack does, o is
such that 1 - a is the mean, over where the ray pierces the plane, of the product of 1 - o g over the plane's voxels.
"""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import atan
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from scenepack.cameras import PERSPECTIVE, photograph_cameras, projection_of
from scenepack.exports.field import ExportFrame, Field, straight_colours
from scenepack.pack import Pack

TYPES = {"f4": "float", "u1": "uchar"}
Column = tuple[str, str]  # name and type, "f4" or "u1"
POINT: tuple[Column, ...] = (
    *((name, "f4") for name in ("x", "y", "z", "nx", "ny", "nz")),
    *((name, "u1") for name in ("red", "green", "blue")),
)


Camera = tuple[dict[str, Any], dict[str, Any]]  # its node and itself in the JSON of a file


@dataclass(frozen=True, eq=False)
class Geometry:
    """A mesh, or points, which have no faces."""

    vertices: np.ndarray  # float32 [v, 3]
    normals: np.ndarray  # float32 [v, 3]; zero if unknown
    colours: np.ndarray  # uint8 [v, 3], diffuse, sRGB
    faces: np.ndarray  # int32 [f, 3], counter-clockwise from outside
    coarser: int = 1  # voxels a side that became one
    cameras: Sequence[Camera] = ()  # of the photographs of a mesh
    point_size: float = 0.0  # of a preview, grid units

    def file_parts(self, file: Path, comments: Sequence[str] = ()) -> list[bytes]:
        """The bytes of a .glb or a .ply; of points, a .ply."""
        if file.suffix.lower() == ".glb":
            return glb_parts(self, comments)
        faces = self.faces if len(self.faces) else None
        return ply_parts(POINT, [self.vertices, self.normals, self.colours], faces, comments)


def ply_parts(
    columns: Sequence[Column],
    values: Sequence[np.ndarray],
    faces: np.ndarray | None = None,
    comments: Sequence[str] = (),
) -> list[bytes]:
    """The file in parts. columns: of a vertex; values: one array [n, k] after the other that together fill them.

    faces: int [f, 3] or None.
    """
    fields = [(name, f"<{kind}") for name, kind in columns]
    table = np.rec.fromarrays([column for array in values for column in array.T], fields)
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment {line}" for line in comments)]
    lines += [f"element vertex {len(table)}", *(f"property {TYPES[kind]} {name}" for name, kind in columns)]
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    parts = ["\n".join([*lines, "end_header", ""]).encode("ascii"), table.tobytes()]
    if faces is not None:
        rows = np.zeros(len(faces), [("count", "u1"), ("vertices", "<i4", 3)])
        rows["count"], rows["vertices"] = 3, faces
        parts.append(rows.tobytes())
    return parts


# --- A mesh with vertex colours as binary glTF 2.0 ---

FLOAT, UINT16, UINT32 = 5126, 5123, 5125  # of OpenGL
ARRAY, ELEMENTS = 34962, 34963
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


def gltf_cameras(pack: Pack, export_frame: ExportFrame) -> list[Camera]:
    """The cameras of the photographs, but for fisheyes and panoramas. Distortion of their lenses is left out, and the principal
    point is the middle of the picture."""
    near = export_frame.stretch * (pack.near or pack.voxel_size)  # of the clipping plane
    cameras: list[Camera] = []
    flat = [camera for camera in photograph_cameras(pack) if projection_of(camera.distortion) == PERSPECTIVE]
    for i, one in enumerate(flat):
        lens = {"yfov": 2.0 * atan(0.5 * one.height / one.fy),
                "aspectRatio": (one.width * one.fy) / (one.height * one.fx), "znear": near}  # fmt: skip
        matrix = export_frame.pose(one.world_T_camera).T.ravel().tolist()  # by columns
        node = {"name": one.name, "camera": i, "matrix": matrix}
        cameras.append((node, {"name": one.name, "type": "perspective", "perspective": lens}))
    return cameras


def glb_parts(geometry: Geometry, comments: Sequence[str]) -> list[bytes]:
    """The file of a mesh in parts. comments: asset.extras."""
    vertices, colours = geometry.vertices, geometry.colours
    colour = np.full((len(colours), 4), 65535, "<u2")
    levels = np.arange(256) / 255.0
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    colour[:, :3] = np.rint(65535 * linear[colours])
    arrays = [
        (vertices.astype("<f4"), FLOAT, "VEC3", ARRAY),
        (geometry.normals.astype("<f4"), FLOAT, "VEC3", ARRAY),
        (colour, UINT16, "VEC4", ARRAY),
        (geometry.faces.astype("<u4").reshape(-1), UINT32, "SCALAR", ELEMENTS),
    ]
    views, accessors, offset = [], [], 0
    for i, (array, kind, shape, target) in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": target})
        accessors.append({"bufferView": i, "componentType": kind, "count": len(array), "type": shape})
        offset += array.nbytes  # multiples of four, all of them
    accessors[0] |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    accessors[2]["normalized"] = True
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "snerg", "extras": {"snerg": comments}},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": list(range(1 + len(geometry.cameras)))}],
        "nodes": [{"name": "mesh", "mesh": 0}, *(node for node, _ in geometry.cameras)],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{
            "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
            "extensions": {"KHR_materials_unlit": {}},
        }],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }  # fmt: skip
    if geometry.cameras:  # glTF forbids empty lists
        document["cameras"] = [camera for _, camera in geometry.cameras]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<III", MAGIC, 2, 12 + 8 + len(text) + 8 + offset)
    binary = struct.pack("<II", offset, BINARY_CHUNK)
    return [head, struct.pack("<II", len(text), JSON_CHUNK), text, binary, *(array.tobytes() for array, *_ in arrays)]


# --- Voxels as 3D Gaussians ---

SIGMA = 0.5  # of a Gaussian, in voxels
SH_0 = 0.28209479177387814  # the spherical harmonic of degree 0
MOST_OPACITY = 0.99
_NAMES = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
COLUMNS: tuple[Column, ...] = tuple((name, "f4") for name in _NAMES.split())


def voxels_of(field: Field, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions float64 [n, 3] (x, y, z in voxels of the pack) and premultiplied rgba float32 [n, 4], of opacity >= least."""
    places: list[np.ndarray] = [np.zeros((0, 3))]
    values: list[np.ndarray] = [np.zeros((0, 4), np.float32)]
    for place in field.occupied:
        cells = field.block(place)
        at = np.argwhere(cells[..., 3] >= least)
        values.append(cells[tuple(at.T)])
        places.append(field.coarser * (at + np.asarray(place) * field.side + 0.5)[:, ::-1])
    return np.concatenate(places), np.concatenate(values)


def gaussian_values(
    positions: np.ndarray, rgba: np.ndarray, field: Field, export_frame: ExportFrame
) -> list[np.ndarray]:
    """What fills COLUMNS: position, no normal, colour, opacity before the sigmoid, logarithms of sizes, rotation (w, x, y, z)."""
    alphas, opacities = opacity_table()
    opacity = np.clip(np.interp(rgba[:, 3], alphas, opacities), 1e-3, MOST_OPACITY)[:, None]
    count = len(positions)
    sizes = SIGMA * field.coarser * export_frame.sizes(positions)
    x, y, z, w = Rotation.from_matrix(export_frame.turned).as_quat(canonical=True)
    return [
        export_frame.points(positions),
        np.zeros((count, 3)),
        (straight_colours(rgba) - 0.5) / SH_0,
        np.log(opacity / (1.0 - opacity)),
        np.log(sizes),
        np.broadcast_to(np.round([w, x, y, z], 12) + 0.0, (count, 4)),
    ]


def opacity_table() -> tuple[np.ndarray, np.ndarray]:
    """Opacities of a plane of voxels, rising, and the Gaussians' own that give them."""
    across = (np.arange(16) + 0.5) / 16 - 0.5
    distance = (across[:, None] - np.arange(-3, 4)) ** 2  # [pierced at, voxel]
    passes = np.exp(-(distance[:, None, :, None] + distance[None, :, None, :]) / (2 * SIGMA**2))
    own = np.linspace(0.0, MOST_OPACITY, 100)
    return np.array([1.0 - np.prod(1.0 - o * passes, axis=(2, 3)).mean() for o in own]), own


# --- Gaussians as SPZ 3 (github.com/nianticlabs/spz), whose axes are x right, y up, z back, as in the grid frame ---

SPZ_MAGIC, SPZ_VERSION = 0x5053474E, 3
SPZ_LARGEST = (1 << 23) - 1  # of a coordinate: 24 bits with their sign
SPZ_SIZES = (-10.0, 255 / 16 - 10.0)  # logarithms
SPZ_COLOUR = 0.15  # of 255 levels, for 1 of f_dc
SPZ_ROTATION = 511 * np.sqrt(2.0)  # levels for 1 of a quaternion's component that is not the largest


def spz_bytes(values: Sequence[np.ndarray]) -> bytes:
    """The file of gaussian_values. UserError where its numbers cannot hold the lengths."""
    positions, _, colours, opacities, sizes, rotations = values
    farthest, small, large = float(np.abs(positions).max()), float(sizes.min()), float(sizes.max())
    places = min(int(np.floor(np.log2(SPZ_LARGEST / max(farthest, 1e-9)))), 24)  # binary, after the point
    if places < 1 or small < SPZ_SIZES[0] or large > SPZ_SIZES[1]:
        expected = "coordinates up to 4e+06, Gaussians of {:.2g} to {:.3g}".format(*np.exp(SPZ_SIZES))
        found = f"{farthest:.3g}, {np.exp(small):.2g} to {np.exp(large):.3g}"
        raise UserError("lengths do not fit into an .spz", where="--scale", expected=expected, found=found,
                        remedy="choose another, or write a .ply")  # fmt: skip
    fixed = np.rint(positions * 2.0**places).astype("<i4")
    header = struct.pack("<IIIBBBB", SPZ_MAGIC, SPZ_VERSION, len(positions), 0, places, 0, 0)
    parts = [
        np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        _levels(255.0 / (1.0 + np.exp(-opacities))),
        _levels(255.0 * (SPZ_COLOUR * colours + 0.5)),
        _levels(16.0 * (sizes - SPZ_SIZES[0])),
        np.full(len(positions), _packed_rotation(*rotations[0]), "<u4"),  # all are turned alike
    ]
    return gzip.compress(header + b"".join(part.tobytes() for part in parts), 6, mtime=0)


def _packed_rotation(w: float, x: float, y: float, z: float) -> int:
    """A unit quaternion in 32 bits: which of x, y, z, w is largest, and of the other three in this order a sign and 9 bits."""
    parts = np.array([x, y, z, w])
    largest = 3 - int(np.argmax(np.abs(parts[::-1])))
    packed, sign = largest, np.copysign(1.0, parts[largest])
    for part in np.delete(sign * parts, largest):
        packed = packed << 10 | int(part < 0) << 9 | round(float(SPZ_ROTATION * abs(part)))
    return packed


def _levels(values: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(values, 0.0, 255.0)).astype(np.uint8)
