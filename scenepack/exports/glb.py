"""A mesh with vertex colours as binary glTF 2.0 (Khronos; ISO/IEC 12113), with the extension KHR_materials_unlit.

The colours are photographed light, so nothing may light them again. COLOR_0 is linear, so they are decoded from sRGB, into 16
bits: 8 would show bands in the dark.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

FLOAT, UINT16, UINT32 = 5126, 5123, 5125  # of OpenGL
ARRAY, ELEMENTS = 34962, 34963
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


def glb_parts(
    vertices: np.ndarray, normals: np.ndarray, colours: np.ndarray, faces: np.ndarray, said: dict[str, Any]
) -> list[bytes]:
    """The file in parts. vertices, normals float32 [v, 3]; colours uint8 [v, 3], sRGB; faces int [f, 3]. said: asset.extras."""
    colour = np.full((len(colours), 4), 65535, "<u2")
    colour[:, :3] = np.rint(65535 * _linear(colours))
    arrays = [
        (vertices.astype("<f4"), FLOAT, "VEC3", ARRAY),
        (normals.astype("<f4"), FLOAT, "VEC3", ARRAY),
        (colour, UINT16, "VEC4", ARRAY),
        (faces.astype("<u4").reshape(-1), UINT32, "SCALAR", ELEMENTS),
    ]
    views, accessors, offset = [], [], 0
    for i, (array, kind, shape, target) in enumerate(arrays):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": array.nbytes, "target": target})
        accessors.append({"bufferView": i, "componentType": kind, "count": len(array), "type": shape})
        offset += array.nbytes  # multiples of four, all of them
    accessors[0] |= {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    accessors[2]["normalized"] = True
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    document = {
        "asset": {"version": "2.0", "generator": "snerg", "extras": said},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [
            {
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<III", MAGIC, 2, 12 + 8 + len(text) + 8 + offset)
    binary = struct.pack("<II", offset, BINARY_CHUNK)
    return [head, struct.pack("<II", len(text), JSON_CHUNK), text, binary, *(array.tobytes() for array, *_ in arrays)]


def _linear(colours: np.ndarray) -> np.ndarray:
    levels = np.arange(256) / 255.0
    table = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    return table[colours]
