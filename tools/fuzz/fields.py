"""Where in a binary file the numbers stand that its reader believes: (offset, bytes, byte order) of each."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

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
