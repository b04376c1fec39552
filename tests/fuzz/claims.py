"""Lies that agree with one another: a pack's JSON and the headers of its files claim the same sizes, which is what a reader
compares before it makes room for them.
"""

import json
import struct
import zlib
from collections.abc import Callable

from tests.fuzz.png import png_of
from tests.fuzz.trees import Tree

PARAMS, INDICES = "scene_params.json", "atlas_indices.png"
AXES = ("width", "height", "depth")
FACTORS = (2, 3, 7, 30, 100, 1000)


def grid(tree: Tree, file: str, axes: list[int], factor: int, block: list[int]) -> None:
    """A grid `factor` times as large along axes of (x, y, z), every macroblock of it stored in one `block`; 255: empty."""
    params = _params(tree)
    if params is None:
        return
    for axis in axes:
        params[f"grid_{AXES[axis]}"] = max(int(params[f"grid_{AXES[axis]}"]) * factor, 1)
    x, y, z = (-(-int(params[f"grid_{axis}"]) // int(params["block_size"])) for axis in AXES)
    if x * y * z > 1 << 22:  # a file of ours that takes longer to write than to read
        return
    tree[PARAMS] = json.dumps(params).encode()
    tree[INDICES] = _png(x, z * y, bytes([0]) + bytes(block) * x)


def atlas(tree: Tree, file: str, axes: list[int], factor: int) -> None:
    """An atlas `factor` times as large along axes of (x, y, z), in the JSON and in the headers of images that show it."""
    params = _params(tree)
    if params is None:
        return
    deep = int(params["atlas_depth"])
    for axis in axes:
        params[f"atlas_{AXES[axis]}"] = int(params[f"atlas_{AXES[axis]}"]) * factor
    tree[PARAMS] = json.dumps(params).encode()
    if '"layout": "grid"' in json.dumps(params):  # pieces are as large as the grid has them, whatever the atlas
        return
    for name, data in tree.items():
        spoil = _HEADERS.get(name.rpartition(".")[2])
        if isinstance(data, bytes) and spoil is not None and name != INDICES:
            for axis in axes:
                data = tree[name] = spoil(data, axis, factor)
    images = -(-deep * factor // 4)
    if 2 in axes and "rgba_000.png" in tree and images < 3000:
        for part in ("rgba", "feature"):
            if (one := tree.get(f"{part}_000.png")) is not None:
                tree.update({f"{part}_{i:03d}.png": one for i in range(images)})


def blocks(tree: Tree, file: str, size: int) -> None:
    """Another block_size, which the grid's images then agree with."""
    params = _params(tree)
    if params is not None:
        params["block_size"] = size
        tree[PARAMS] = json.dumps(params).encode()
        grid(tree, file, [], 1, [0, 0, 0])


def planes(tree: Tree, file: str, count: int) -> None:
    params = _params(tree)
    if params is not None and isinstance(params.get("snerg"), dict) and "codec_settings" in params["snerg"]:
        params["snerg"]["codec_settings"]["planes"] = count
        tree[PARAMS] = json.dumps(params).encode()


def _params(tree: Tree) -> dict | None:
    try:
        data = tree.get(PARAMS)
        params = json.loads(data) if isinstance(data, bytes) else None
        known = (*(f"{what}_{axis}" for what in ("grid", "atlas") for axis in AXES), "block_size")
        return params if isinstance(params, dict) and all(0 < int(params[key]) < 1 << 20 for key in known) else None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


def _png(width: int, height: int, row: bytes) -> bytes:
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    return png_of([(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", data), (b"IEND", b"")])


def _png_header(data: bytes, axis: int, factor: int) -> bytes:
    if axis == 2 or len(data) < 33:
        return data
    sides = list(struct.unpack(">II", data[16:24]))
    sides[axis] = sides[axis] * factor % 2**31
    head = data[12:16] + struct.pack(">II", *sides) + data[24:29]
    return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]


def _webp_header(data: bytes, axis: int, factor: int) -> bytes:
    if len(data) < 25:
        return data
    bits = int.from_bytes(data[21:25], "little")
    sides = [(bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1]
    at = 0 if axis == 0 else 1  # planes lie below one another
    sides[at] = min(sides[at] * factor, 0x4000)
    bits = bits >> 28 << 28 | sides[0] - 1 | sides[1] - 1 << 14
    return data[:21] + bits.to_bytes(4, "little") + data[25:]


def _film_header(data: bytes, axis: int, factor: int) -> bytes:
    box, first = (b"stsz", 8) if axis == 2 else (b"ispe", 4 + 4 * axis)
    at = data.find(box) + 4 + first
    if at < 4 + first or at + 4 > len(data):
        return data
    value = int.from_bytes(data[at : at + 4], "big") * factor % 2**32
    return data[:at] + value.to_bytes(4, "big") + data[at + 4 :]


_HEADERS: dict[str, Callable[[bytes, int, int], bytes]] = {
    "png": _png_header, "webp": _webp_header, "avif": _film_header, "mp4": _film_header,
}  # fmt: skip
