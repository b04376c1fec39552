"""The films of an AVIF pack, as a web page holds them; viewer/web/static/decode.js decodes them.

A film is the AV1 of one image sequence (scenepack.codecs.avif): samples, one for each plane of a piece. Browsers decode
them to the same bytes as the desktop does. The rest of the file is left out.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

from scenepack.codecs import CodecError
from scenepack.codecs.avif import AvifCodec, numbers_in
from scenepack.codecs.quantisation import EXACT
from scenepack.codecs.streams import cubes_in
from scenepack.piece_files import GridPiece
from scenepack.reader import open_pack

DEPTH = "08"  # bits of a channel, in the name of a codec


@dataclass(frozen=True)
class Film:
    """The samples of one image sequence."""

    codec: str  # as browsers name it
    sizes: tuple[int, ...]  # bytes of each sample
    data: bytes  # all samples


# A piece of the grid; which of its voxels have any alpha, as scenepack.codecs.streams packs it, but as zlib; and its films:
# alpha, rgb; in packs with features also their first three channels, and the fourth.
FilmedPiece = tuple[GridPiece, bytes, list[Film]]


def films_of(path: Path) -> list[FilmedPiece] | None:
    """Those of the pack at `path`; None where it is not AVIF in the usual layout. UserError where it cannot be read."""
    with open_pack(path) as reader:
        pieces = reader.pieces
        if pieces is None or not isinstance(pieces.codec, AvifCodec) or pieces.steps != EXACT:
            return None
        made = []
        for piece, names in zip(pieces.pieces, pieces.names, strict=True):
            if not isinstance(piece, GridPiece):
                return None
            occupancy, *files = (reader.files.read(name, reader.files.sizes[name]) for name in names)
            films = [film for data in files if (film := film_in(data, piece.shape[0])) is not None]
            if len(films) < len(files):
                return None
            made.append((piece, zlib.compress(cubes_in(occupancy, piece.shape), 9), films))
    return made


def film_in(data: bytes, frames: int) -> Film | None:
    """The film in an AVIF file of so many frames; None where its samples do not lie one behind the other."""
    try:
        uniform, count, *sizes = numbers_in(data, b"stsz", 2 + frames)
        chunks, start = numbers_in(data, b"stco", 2)
    except CodecError:
        return None
    settings = data.find(b"av1C")
    if uniform or count != frames or chunks != 1 or start + sum(sizes) > len(data) or settings < 0:
        return None
    kind, tier = data[settings + 5], "H" if data[settings + 6] >> 7 else "M"
    profile, level = kind >> 5, kind & 31
    return Film(f"av01.{profile}.{level:02d}{tier}.{DEPTH}", tuple(sizes), data[start : start + sum(sizes)])
