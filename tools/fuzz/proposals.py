"""Which steps are tried on a tree: drawn at random, but by somebody who knows the formats."""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Iterator
from math import prod
from pathlib import PurePosixPath
from random import Random
from typing import Any

from tests.fuzz import claims, hostile
from tests.fuzz.mutations import Step, documents, tensors
from tests.fuzz.png import png_chunks
from tests.fuzz.trees import ARCHIVE, SPECIAL, Tree, zipped

_HOW_MANY = (1, 1, 1, 1, 2, 2, 3)
_DTYPES = ("float64", "float16", "int64", "int32", "uint8", "bool")
_FILLS = (0, 1, -1, 1e30, float("nan"), float("inf"), 2**31 - 1, -(2**31), 2**40)
_NPY_WORDS = (("<f8", "|O"), ("<f8", "<U9"), ("<f8", "<i8"), ("<f8", "<c16"), ("<f8", ">f8"), ("<f8", "V8"),
              ("<f8", "|S99999999"),
              ("False", "True"), ("17", "0"), ("17", "17000000000"), ("17", "-17"), ("17", "1" * 400), ("shape", "shapf"),
              ("{", "[" * 400), ("}", ""), ("(", "(9, "), ("17", "17, 1"), ("descr", "\0escr"))  # fmt: skip


# As they stand in a JSON file; json.dumps would not write most of them.
RAW = (
    "0", "-1", "1", "2", "255", "256", "65535", "65536", "2147483647", "2147483648", "4294967296", "9223372036854775808",
    "1" + "0" * 400, "-" + "7" * 5000, "1e308", "-1e308", "1e-308", "1e999", "-1e999", "1e30", "1e-300", "0.5", "-0.0",
    "Infinity", "-Infinity", "NaN", "true", "false", "null", "[]", "{}", '""', '"text"', '"0"', '"NaN"', '"1e999"', "[null]",
    '{"x": {}}', "[[1, 2], [3]]", "[[1e308, 1e308, 1e308, 1e308]]", '"a\\u0000b"', '"\\ud800"', '"\\u001b[31m\\u0007"',
    '"two\\nlines\\u2028\\u202e"', '"../../../../etc/passwd"', '"/dev/zero"', '"/"', '"."', '""', '"~"', '"con\\\\x"',
    *hostile.LARGE,
)  # fmt: skip
WHOLE = (
    0, 1, 2, 3, 127, 128, 255, 256, 1023, 4096, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63,
    2**64 - 1,
)  # fmt: skip
FLOATS = (0.0, -1.0, 1e-300, 1e30, 1e300, float("inf"), float("-inf"), float("nan"))


def propose(random: Random, tree: Tree, archived: bool) -> list[Step]:
    """One to three steps for a tree; where it is archived, some of them on the archive."""
    steps: list[Step] = []
    for _ in range(random.choice(_HOW_MANY)):
        if archived and random.random() < 0.35:
            steps.append(_of_archive(random, tree))
        elif claims.PARAMS in tree and random.random() < 0.15:
            steps.append(_claim(random))
        else:
            steps.append(_of_file(random, tree))
    if archived and all(step[1] != ARCHIVE for step in steps):
        steps.append(["cut", ARCHIVE, 2**40])  # which leaves it whole
    return steps


def _claim(random: Random) -> Step:
    axis, factor = random.randrange(3), random.choice(claims.FACTORS)
    axes = random.choice([[axis], [0, 1, 2]])
    block = random.choice([[0, 0, 0], [0, 0, 0], [255, 255, 255], [0, 0, 1], [9, 0, 0]])
    return random.choice([
        ["claim grid", claims.PARAMS, axes, factor, block], ["claim atlas", claims.PARAMS, axes, factor],
        ["claim atlas", claims.PARAMS, axes, factor], ["claim blocks", claims.PARAMS, random.choice((1, 2, 6, 62, 1022, 1024))],
        ["claim planes", claims.PARAMS, random.choice((1, 6, 12, 126, 600, 6000))],
    ])  # fmt: skip


def _of_archive(random: Random, tree: Tree) -> Step:
    data = zipped(tree)
    if random.random() < 0.7:
        return _of_fields(random, ARCHIVE, data, archive(data))
    return _of_bytes(random, ARCHIVE, data)


def _of_file(random: Random, tree: Tree) -> Step:
    described = [name for name in tree if name.endswith((".json", ".jsonl"))]
    file = random.choice(described) if described and random.random() < 0.4 else random.choice(list(tree))
    data = tree[file]
    if random.random() < 0.08 or not isinstance(data, bytes) or not data:
        return _of_tree(random, tree, file)
    if random.random() < 0.12:
        return _of_bytes(random, file, data)
    suffix = PurePosixPath(file).suffix
    with contextlib.suppress(ValueError, KeyError, struct.error, RecursionError):
        if suffix in (".json", ".jsonl"):
            return _of_json(random, file, documents(data)[0])
        if suffix == ".png" and random.random() < 0.8:
            return _of_png(random, file, data)
        if suffix == ".safetensors" and random.random() < 0.9:
            return _of_tensors(random, file, data)
        if suffix == ".npy" and random.random() < 0.7:
            return _of_npy(random, file, data)
        if suffix in BY_SUFFIX:
            return _of_fields(random, file, data, BY_SUFFIX[suffix](data))
    return _of_bytes(random, file, data)


def _of_tree(random: Random, tree: Tree, file: str) -> Step:
    other = random.choice(list(tree))
    kind = random.choice(list(hostile.contents()))
    return random.choice([
        ["remove", file], ["swap", file, other], ["copy", file, other], ["instead", file, random.choice(SPECIAL)],
        ["instead", file, random.choice(SPECIAL)], ["content", file, kind], ["content", file, kind],
        ["rename", file, random.choice([file.upper(), file + ".bak", "x" * 240, "\x1b[2J" + file, "deep/" + file, "_" + file])],
    ])  # fmt: skip


def _of_bytes(random: Random, file: str, data: bytes) -> Step:
    near = random.random() < 0.5  # headers matter most
    at = random.randrange(min(len(data), 64) if near else len(data)) if data else 0
    some = random.randbytes(random.choice((1, 1, 2, 4, 8))).hex()
    return random.choice([
        ["cut", file, random.choice([0, 1, 4, 8, at, at, len(data) - 1, len(data) // 2])],
        ["put", file, at, some], ["put", file, at, "00" * 8], ["put", file, at, "ff" * 8],
        ["insert", file, at, some, random.choice((1, 1, 100, 10_000))],
        ["erase", file, at, random.choice((1, 2, 4, 8, 64))],
        ["repeat", file, at, random.choice((1, 8, 64, 1024)), random.choice((2, 3, 50))],
    ])  # fmt: skip


def _of_fields(random: Random, file: str, data: bytes, known: list[Field]) -> Step:
    if not known:
        return _of_bytes(random, file, data)
    at, size, order = random.choice(known)
    old = int.from_bytes(data[at : at + size], order)  # type: ignore[arg-type]
    near = [old + 1, old - 1, old * 2, old // 2, old << 8, old ^ 1 << random.randrange(8 * size)]
    if size == 8 and random.random() < 0.3:
        return ["put", file, at, struct.pack("<d", random.choice(FLOATS)).hex()]
    value = random.choice(near) if random.random() < 0.4 else number_of(random, size)
    return ["put", file, at, (value % 256**size).to_bytes(size, order).hex()]  # type: ignore[arg-type]


def _of_json(random: Random, file: str, document: Any) -> Step:
    path: list[Any] = []
    inner = document
    while isinstance(inner, dict | list) and inner and random.random() < (0.97 if not path else 0.75):
        key = random.choice(list(inner)) if isinstance(inner, dict) else random.randrange(len(inner))
        path.append(key)
        inner = inner[key]
    kind = random.random()
    if kind < 0.8 or not path:
        return ["json set", file, path, value_for(random, inner)]
    if kind < 0.88:
        return ["json drop", file, path]
    if isinstance(path[-1], int):
        return ["json set", file, path, random.choice(RAW)]
    if kind < 0.96:
        return ["json again", file, path, value_for(random, inner)]
    return ["json name", file, path, random.choice(["", "x" * 1000, "\x1b[31m", path[-1] + " ", "__proto__"])]


def _of_png(random: Random, file: str, data: bytes) -> Step:
    chunks = png_chunks(data)
    chunk = random.choice([0, 0, random.randrange(len(chunks))])
    payload = chunks[chunk][1]
    kinds = [
        "IHDR", "PLTE", "tRNS", "acTL", "fcTL", "iCCP", "zTXt", "iTXt", "eXIf", "gAMA", "sBIT", "IDAT", "IEND",
        "AAAA",
    ]  # fmt: skip
    size = random.choice((1, 4, 4))
    at = (
        random.randrange(0, max(len(payload) - size + 1, 1)) if chunk else random.choice((0, 0, 4, 4, 8, 9, 10, 11, 12))
    )
    number = number_of(random, 1 if chunk == 0 and at >= 8 else size)
    old = int.from_bytes(payload[at : at + 4], "big") if chunk == 0 and at < 8 else None
    if old is not None:
        number = random.choice([number, old + 1, old - 1, old * 2, old * 1000, 65_535]) % 2**32
    width = 4 if old is not None else 1 if chunk == 0 else size
    return random.choice([
        ["png put", file, chunk, at, (number % 256**width).to_bytes(width, "big").hex()],
        ["png put", file, chunk, at, (number % 256**width).to_bytes(width, "big").hex()],
        ["png add", file, random.randrange(len(chunks) + 1), random.choice(kinds), random.randbytes(13).hex(),
         random.choice((1, 1, 40, 5000))],
        ["png add", file, random.randrange(1, len(chunks) + 1), "IHDR",
         struct.pack(">IIBBBBB", *random.choices((1, 4, 64, 30_000, 2**31 - 1), k=2), 8, 6, 0, 0, 0).hex(), 1],
        ["png drop", file, chunk],
        ["png pixels", file, random.randrange(2000), random.randbytes(4).hex()],
    ])  # fmt: skip


def _of_tensors(random: Random, file: str, data: bytes) -> Step:
    described, _ = tensors(data)
    names = [name for name in described if name != "__metadata__"]
    name = random.choice(names)
    shape = described[name]["shape"]
    if random.random() < 0.15:
        step = _of_json(random, file, described)
        return (
            ["tensor header", file, step[2], step[3]]
            if step[0] == "json set"
            else ["cut", file, random.randrange(len(data))]
        )
    size = prod(shape)
    reshapes = [[-1], [1, size], [size, 1], [], [0, *shape], [*reversed(shape)], [1, *shape]]
    place = random.randrange(max(size, 1))
    return random.choice([
        ["tensor", file, name, "remove", None], ["tensor", file, name, "cut", None],
        ["tensor", file, name, "rename", random.choice([*names, name + "x", "x"])],
        ["tensor", file, name, "reshape", random.choice(reshapes)], ["tensor", file, name, "more", random.choice((2, 5))],
        ["tensor", file, name, "type", random.choice(_DTYPES)], ["tensor", file, name, "type", random.choice(_DTYPES)],
        ["tensor", file, name, "fill", random.choice(_FILLS)], ["tensor", file, name, "set", [place, random.choice(_FILLS)]],
        ["tensor", file, name, "set", [place, random.choice(_FILLS)]],
    ])  # fmt: skip


def _of_npy(random: Random, file: str, data: bytes) -> Step:
    if random.random() < 0.5:
        return ["npy header", file, *random.choice(_NPY_WORDS)]
    start = 10 + struct.unpack_from("<H", data, 8)[0]
    at = start + 8 * random.randrange(max((len(data) - start) // 8, 1))
    return ["put", file, at, struct.pack("<d", random.choice(FLOATS)).hex()]


# Where in a binary file the numbers stand that its reader believes: (offset, bytes, byte order) of each

Field = tuple[int, int, str]
_HOLDERS = set(b"moov trak mdia minf stbl meta iprp ipco dinf edts stsd avc1 av01".split())
_SKIPPED = {b"meta": 4, b"stsd": 8, b"avc1": 78, b"av01": 78}  # before the boxes within
_MOST_WORDS = 24  # of one box, chunk or segment


def boxes(data: bytes) -> list[Field]:
    """MP4 and AVIF (ISO base media): the sizes and kinds of boxes, and the words in them."""
    return [
        field
        for start, head, end in _boxes(data, 0, len(data))
        for field in [(start, 4, "big"), (start + 4, 4, "big"), *_words(start + head, end, 4, "big"),
                      *_words(start + head, min(end, start + head + 8), 2, "big")]
    ]  # fmt: skip


def _boxes(data: bytes, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    while start + 8 <= end:
        size, kind = struct.unpack_from(">I4s", data, start)
        size = size if 8 <= size <= end - start else end - start
        yield start, 8, start + size
        if kind in _HOLDERS:
            yield from _boxes(data, start + 8 + _SKIPPED.get(kind, 0), start + size)
        start += size


def segments(data: bytes) -> list[Field]:
    """JPEG: lengths of segments, and what the frame's header says."""
    found: list[Field] = []
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        found += [(at + 1, 1, "big"), (at + 2, 2, "big")]
        length = struct.unpack_from(">H", data, at + 2)[0]
        found += [(at + 4 + i, 1, "big") for i in range(min(length - 2, _MOST_WORDS))]
        if 0xC0 <= data[at + 1] <= 0xC3:
            found += [(at + 5, 2, "big"), (at + 7, 2, "big")] * 4
        at += 2 + length
    return found


def riff(data: bytes) -> list[Field]:
    """WebP: sizes of chunks, and the first words in them."""
    found: list[Field] = [(4, 4, "little")]
    at = 12
    while at + 8 <= len(data):
        size = struct.unpack_from("<I", data, at + 4)[0]
        found += [(at, 4, "little"), (at + 4, 4, "little")]
        found += [(at + 8 + i, width, "little") for i in range(10) for width in (1, 2, 4)]
        at += 8 + size + size % 2
    return found


def archive(data: bytes) -> list[Field]:
    """ZIP: all numbers of the local and central headers and of the end."""
    layouts = {
        b"PK\x03\x04": ((4, 2), (6, 2), (8, 2), (14, 4), (18, 4), (22, 4), (26, 2), (28, 2)),
        b"PK\x01\x02": ((4, 2), (6, 2), (8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (30, 2), (32, 2), (34, 2), (38, 4),
                        (42, 4), (46, 1), (47, 1)),
        b"PK\x05\x06": ((4, 2), (6, 2), (8, 2), (10, 2), (12, 4), (16, 4), (20, 2)),
    }  # fmt: skip
    found: list[Field] = []
    for signature, layout in layouts.items():
        at = data.find(signature)
        while at >= 0:
            found += [(at + offset, size, "little") for offset, size in layout]
            at = data.find(signature, at + 4)
    return found


def words(data: bytes) -> list[Field]:
    """COLMAP's binaries and whatever else is little-endian words, most of all at the beginning."""
    return _words(0, min(len(data), 200), 8, "little") * 2 + _words(0, len(data), 8, "little", most=400)


def header(data: bytes) -> list[Field]:
    """The first bytes of anything."""
    return [
        (at, size, order) for at in range(min(len(data), 40)) for size in (1, 2, 4, 8) for order in ("big", "little")
    ]


def _words(start: int, end: int, size: int, order: str, most: int = _MOST_WORDS) -> list[Field]:
    return [(at, size, order) for at in range(start, min(end, start + size * most) - size + 1, size)]


BY_SUFFIX: dict[str, Callable[[bytes], list[Field]]] = {
    ".mp4": boxes, ".avif": boxes, ".jpg": segments, ".jpeg": segments, ".webp": riff, ".zip": archive, ".bin": words,
    ".npy": header, ".safetensors": header, ".xz": header, ".png": header,
}  # fmt: skip


def value_for(random: Random, old: Any) -> str:
    """JSON text in place of `old`: something hostile, or something a little different."""
    if isinstance(old, bool) or random.random() < 0.6:
        return random.choice(RAW)
    if isinstance(old, int | float):
        changed = [old + 1, old - 1, -old, old * 2, old * 1000, old / 3, old * random.uniform(0.5, 2), round(old) + 0.5]
        return json.dumps(random.choice(changed))
    if isinstance(old, str):
        half = len(old) // 2
        others = [old[:half], old + "x", old.upper(), old * 3, f"../{old}", f"/{old}", old[half:]]
        return json.dumps(random.choice(others))
    if isinstance(old, list) and old:
        several = [old[:-1], old[1:], old + old, [*old, old[0]], [old], old[0], list(reversed(old)), old * 40]
        return json.dumps(random.choice(several))
    return random.choice(RAW)


def number_of(random: Random, size: int) -> int:
    """A whole number of `size` bytes that a header's reader may not expect."""
    return random.choice([*WHOLE, random.getrandbits(8 * size)]) % 256**size
