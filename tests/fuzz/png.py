"""PNG as chunks, with checksums that are right whatever they hold."""

import struct
import zlib

SIGNATURE = b"\x89PNG\r\n\x1a\n"
Chunk = tuple[bytes, bytes]  # kind, payload


def png_chunks(data: bytes) -> list[Chunk]:
    """The chunks of a PNG. ValueError for what is none."""
    if data[:8] != SIGNATURE:
        raise ValueError
    found, at = [], 8
    while at + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        found.append((kind, data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found


def png_of(chunks: list[Chunk]) -> bytes:
    parts = [struct.pack(">I", len(p)) + k + p + struct.pack(">I", zlib.crc32(k + p)) for k, p in chunks]
    return SIGNATURE + b"".join(parts)
