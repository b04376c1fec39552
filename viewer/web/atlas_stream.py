"""Lossless compression of an atlas for the web page; viewer/web/static/decode.js is the decoder.

Notation: bs data voxels a side of a macroblock, B = bs + 2; s is bs where the padding copies the neighbours' voxels, else B;
v[c] channel c of a voxel (0 … 2 colour, 3 alpha, 4 … 7 features), a = v[3].
Only voxels that hold anything are stored: a bit each, and what differs from a prediction. With S[c] the sum of v[c] over those of
the three voxels before it (in x, y and z, in the same macroblock) that hold anything, and n their number, the prediction is

    a:    S[3] / n            c != 3:    min(255, S[c] a / S[3])            rounded; 0 where it would divide by 0.

Colours are premultiplied, so it is the colour S[c] / S[3] that continues from voxel to voxel. On the demo this takes a quarter
fewer bytes than lossless WebP. zlib compresses both; every browser brings the inflater, and no picture decoder can change a byte.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np

from scenepack.blocks import block_copy
from scenepack.pack import Pack
from scenepack.piece_files import follows_grid

BLOCKS_A_CHUNK = 48  # macroblocks compressed together; the page shows its progress by chunks
LEVEL = 9
ALPHA = 3


def has_copied_padding(pack: Pack) -> bool:
    """Whether all padding is a copy of the neighbours' voxels, as it should be, so that it need not be stored."""
    parts = (pack.atlas_rgba, pack.atlas_features)
    return all(follows_grid(pack, part) for part in parts if part is not None)


def compressed_chunks(pack: Pack, *, features: bool, padding: bool) -> Iterator[tuple[bytes, bytes]]:
    """For each BLOCKS_A_CHUNK macroblocks, in the grid's order: compressed bits and differences, with what is asked for."""
    blocks = [tuple(block) for block in np.argwhere(pack.occupied).tolist()]
    inside = (slice(None),) * 3 if padding else (slice(1, -1),) * 3
    atlases = [pack.atlas_rgba]
    if features and pack.atlas_features is not None:
        atlases.append(pack.atlas_features)
    for start in range(0, len(blocks), BLOCKS_A_CHUNK):
        some = blocks[start : start + BLOCKS_A_CHUNK]
        copies = [np.concatenate([block_copy(pack, atlas, block)[inside] for atlas in atlases], -1) for block in some]
        filled, differences = differences_from_prediction(np.stack(copies))
        bits = np.packbits(filled, bitorder="little")
        yield zlib.compress(bits.tobytes(), LEVEL), zlib.compress(differences.tobytes(), LEVEL)


def differences_from_prediction(blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """uint8 [n, s, s, s, C] as bool [n, s, s, s], which voxels hold anything, and uint8 [C, m], those voxels' differences."""
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
    return filled, np.ascontiguousarray(((values - predicted) & 255).astype(np.uint8).T)
