"""An atlas as the web page holds it, compressed without loss; viewer/web/static/decode.js is the decoder.

Notation: bs data voxels a side of a macroblock, B = bs + 2; s is bs where the padding copies the neighbours' voxels, else B;
v[c] channel c of a voxel (0 … 2 colour, 3 alpha, 4 … 7 features), a = v[3].
Only voxels that hold anything are stored: a bit each, and what differs from a prediction. With S[c] the sum of v[c] over those of
the three voxels before it (in x, y and z, in the same macroblock) that hold anything, and n their number, the prediction is

    a:    S[3] / n            c != 3:    min(255, S[c] a / S[3])            rounded; 0 where it would divide by 0.

Colours are premultiplied, so it is the colour S[c] / S[3] that continues from voxel to voxel. The differences of red and blue are
stored less that of green, which they mostly share. What is left is noise: DEFLATE without references to earlier bytes makes it
smaller, in a fiftieth of the time. Every browser brings the inflater, and no picture decoder can change a byte.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenepack.blocks import block_copy
from scenepack.codecs import CodecError
from scenepack.codecs.films import AvifCodec, cubes_in, numbers_in
from scenepack.codecs.quantisation import EXACT
from scenepack.pack import Pack
from scenepack.piece_files import Piece
from scenepack.reader import open_pack

BLOCKS_A_CHUNK = 48  # macroblocks compressed together; the page shows its progress by chunks
ALPHA = 3


def compressed_chunks(pack: Pack, *, features: bool, padding: bool) -> Iterator[tuple[bytes, bytes]]:
    """For each BLOCKS_A_CHUNK macroblocks, in the grid's order: compressed bits and differences, with what is asked for."""
    blocks = [tuple(block) for block in np.argwhere(pack.occupied).tolist()]
    inside = (slice(None),) * 3 if padding else (slice(1, -1),) * 3
    atlases = pack.atlases if features else [pack.atlas_rgba]
    for start in range(0, len(blocks), BLOCKS_A_CHUNK):
        some = blocks[start : start + BLOCKS_A_CHUNK]
        copies = [np.concatenate([block_copy(pack, atlas, block)[inside] for atlas in atlases], -1) for block in some]
        filled, differences = differences_from_prediction(np.stack(copies))
        bits = np.packbits(filled, bitorder="little")
        compressor = zlib.compressobj(memLevel=9, strategy=zlib.Z_RLE)  # which refers to the byte before only
        yield zlib.compress(bits.tobytes(), 9), compressor.compress(differences.tobytes()) + compressor.flush()


def differences_from_prediction(blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """uint8 [n, s, s, s, C] as bool [n, s, s, s], which voxels hold anything, and uint8 [C, m], their differences as stored."""
    filled: np.ndarray = np.asarray(blocks.any(axis=-1))
    values = blocks.astype(np.int32)
    count = np.zeros(filled.shape, np.int32)
    sums = np.zeros_like(values)
    for axis in (1, 2, 3):
        before, after = (tuple([slice(None)] * axis + [part]) for part in (slice(0, -1), slice(1, None)))
        sums[after] += values[before]
        count[after] += filled[before]
    values, sums, count = values[filled], sums[filled], count[filled]
    alpha, total = values[:, ALPHA, None], sums[:, ALPHA, None]
    predicted = np.minimum((2 * sums * alpha + total) // np.maximum(2 * total, 1), 255)
    predicted[total[:, 0] == 0] = 0
    predicted[:, ALPHA] = (2 * sums[:, ALPHA] + count) // np.maximum(2 * count, 1)
    differences = np.ascontiguousarray(((values - predicted) & 255).astype(np.uint8).T)
    differences[[0, 2]] -= differences[1]
    return filled, differences


# --- The films of an AVIF pack, which a page holds instead ---
#
# A film is the AV1 of one image sequence (scenepack.codecs.films): samples, one for each plane of a piece. Browsers decode
# them to the same bytes as the desktop does. The rest of the file is left out.

DEPTH = "08"  # bits of a channel, in the name of a codec


@dataclass(frozen=True)
class Film:
    codec: str  # as browsers name it
    sizes: tuple[int, ...]  # bytes of each sample
    data: bytes  # all samples


# A piece of the grid; which of its voxels have any alpha, as scenepack.codecs.films packs it, but as zlib; and its films:
# alpha, rgb; in packs with features also their first three channels, and the fourth.
FilmedPiece = tuple[Piece, bytes, list[Film]]


def films_of(path: Path) -> list[FilmedPiece] | None:
    """The pieces of the pack at `path` as films; None where it is not AVIF in the usual layout. UserError: unreadable."""
    with open_pack(path) as reader:
        if not isinstance(reader.codec, AvifCodec) or reader.layout != "grid" or reader.steps != EXACT:
            return None
        made = []
        for piece, names in zip(reader.pieces, reader.names, strict=True):
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
