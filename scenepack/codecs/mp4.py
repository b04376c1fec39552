"""The one film in an MP4 (ISO/IEC 14496-12 and -15): which bytes are its frames. FFmpeg's own reader of MP4 believes what the
tables claim, allocates for it, follows edit lists, and knows boxes that lead to other files.

Notation: a box is its size (u32), its type (4 bytes) and its contents; some contain boxes. The samples, frames in the order of
decoding, lie in chunks: stco (or co64) has the chunks' places, stsc how many samples are in each, stsz the samples' sizes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from scenepack.codecs.base import CodecError

WAY = (b"mdia", b"minf", b"stbl")  # of boxes, from a track to its tables
ENTRY = struct.Struct(">24xHH50x")  # of stsd: width and height; boxes follow


@dataclass(frozen=True)
class Film:
    """width, height: pixels. setup: the decoder's (avcC). samples: the bytes of each frame."""

    width: int
    height: int
    setup: bytes
    samples: list[memoryview]


def read_film(data: bytes, most: int) -> Film:
    """CodecError unless `data` is an MP4 of one H.264 film of at most so many frames, which all lie in it."""
    try:
        return _film(memoryview(data), most)
    except (struct.error, KeyError, IndexError) as error:
        raise CodecError("the film is damaged") from error


def _film(data: memoryview, most: int) -> Film:
    tracks = [track for kind, track in _boxes(_only(data, b"moov")) if kind == b"trak"]
    tables = []
    for track in tracks:
        for kind in WAY:
            track = _only(track, kind)
        tables.append({kind: contents[4:] for kind, contents in _boxes(track)})  # after version and flags
    entries = [_only_entry(table[b"stsd"]) for table in tables]
    found = ", ".join(kind.decode("latin-1") for kind, _ in entries)
    if [kind for kind, _ in entries] != [b"avc1"]:
        raise CodecError(f"it holds {found or 'no film'}, expected one film of H.264 (avc1)")
    [(_, entry)], [table] = entries, tables
    width, height = ENTRY.unpack_from(entry)
    setup = bytes(_only(entry[ENTRY.size :], b"avcC"))
    return Film(width, height, setup, list(_samples(data, table, most)))


def _only_entry(descriptions: memoryview) -> tuple[bytes, memoryview]:
    """The coding of a track and its description."""
    (count,) = struct.unpack_from(">I", descriptions)
    if count != 1:
        raise CodecError(f"its frames are coded in {count} ways")
    return next(_boxes(descriptions[4:]))


def _samples(data: memoryview, table: dict[bytes, memoryview], most: int) -> Iterator[memoryview]:
    size, count = struct.unpack_from(">II", table[b"stsz"])
    if count > most:
        raise CodecError(f"it holds more than the {most} frames expected")
    sizes = [size] * count if size else struct.unpack_from(f">{count}I", table[b"stsz"], 8)
    places = table[b"co64"] if b"co64" in table else table[b"stco"]
    width = 8 if b"co64" in table else 4
    runs = struct.unpack_from(">I", table[b"stsc"])[0]
    done = chunk = run = 0
    left = sum(sizes)
    if left > len(data):
        raise CodecError("its frames share bytes")
    while done < count:
        if run + 1 < runs and struct.unpack_from(">I", table[b"stsc"], 4 + 12 * (run + 1))[0] == chunk + 1:
            run += 1
        per_chunk = struct.unpack_from(">I", table[b"stsc"], 8 + 12 * run)[0]
        if not per_chunk:
            raise CodecError("the film is damaged")
        at = int.from_bytes(places[4 + width * chunk : 4 + width * (chunk + 1)], "big")
        for size in sizes[done : done + per_chunk]:
            if at + size > len(data):
                raise CodecError("it is cut off")
            yield data[at : at + size]
            at += size
        done += per_chunk
        chunk += 1


def _boxes(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Type and contents of one box after the other."""
    at = 0
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        head = 8
        if size == 1:
            (size,) = struct.unpack_from(">Q", data, at + 8)
            head = 16
        size = size or len(data) - at
        if size < head or at + size > len(data):
            raise CodecError("it is cut off")
        yield kind, data[at + head : at + size]
        at += size


def _only(data: memoryview, kind: bytes) -> memoryview:
    """The contents of the one box of that type."""
    found = [contents for name, contents in _boxes(data) if name == kind]
    if len(found) != 1:
        raise CodecError(f"the film is damaged: {len(found)} boxes {kind.decode()}")
    return found[0]
