"""Files of atlas pieces.

Notation: bs data voxels a side of a macroblock, B = bs + 2; a piece is uint8 [D, H, W, 4]. Two layouts:
- "atlas": some consecutive planes of the atlas, as they are.
- "grid": the data voxels of some consecutive layers of macroblocks where they lie in the grid, cropped to the macroblocks in use.
  Content continues from macroblock to macroblock, which predicts far better than the atlas's patchwork; the padding, 18 % of the
  voxels at bs = 30, is left out and copied again by scenepack.blocks; what is empty costs next to nothing.
PNG, the published format, has four planes of the atlas to a piece. Other packs keep "codec_settings" under "snerg": layout and
planes of a piece, the steps that values are counted in where they are coarse, and the quality. All else follows from the
indirection grid.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.pool import ThreadPool
from typing import Any

import numpy as np

from console import UserError
from scenepack.blocks import restore_padding
from scenepack.codecs import Codec, PngCodec
from scenepack.codecs.base import Layout, Shape
from scenepack.codecs.images import probe_png
from scenepack.codecs.quantisation import EXACT, MOST_STEP, Steps, steps_of, to_counts
from scenepack.constants import PLANES_PER_IMAGE
from scenepack.files import PackFiles
from scenepack.pack import Pack

Box = tuple[slice, ...]


@dataclass(frozen=True)
class Piece:
    """Some voxels of an atlas. gather() takes them; scatter() writes them back, each piece's to others."""

    shape: Shape
    size: Shape  # of each of n boxes, which hold them; the rest of the piece is zeros
    places: np.ndarray  # int [n, 2, 3] (z, y, x): where the boxes begin in the piece, and in the atlas
    corner: Shape = (0, 0, 0)  # of the "grid" layout: where the piece begins in the grid (z, y, x), in blocks

    def boxes(self) -> Iterator[list[Box]]:
        """Each box in the piece, and in the atlas."""
        for place in self.places.tolist():
            yield [tuple(slice(i, i + n) for i, n in zip(first, self.size, strict=True)) for first in place]

    def gather(self, atlas: np.ndarray) -> np.ndarray:
        values = np.zeros((*self.shape, atlas.shape[3]), np.uint8)
        for inside, data in self.boxes():
            values[inside] = atlas[data]
        return values

    def scatter(self, values: np.ndarray, atlas: np.ndarray) -> None:
        for inside, data in self.boxes():
            atlas[data] = values[inside]


def cut(pack: Pack, layout: Layout, planes: int) -> list[Piece]:
    """All pieces of a pack, or of its outline; `planes` in each, but fewer in the last of the "grid" layout."""
    depth, height, width = pack.atlas_rgba.shape[:3]
    if layout == "atlas":
        shape = (planes, height, width)
        sizes = [(z, (min(planes, depth - z), height, width)) for z in range(0, depth, planes)]
        return [Piece(shape, size, np.array([[[0, 0, 0], [z, 0, 0]]])) for z, size in sizes]
    size = pack.block_size
    step = planes // size
    pieces = []
    for start in range(0, pack.occupied.shape[0], step):
        where = np.argwhere(pack.occupied[start : start + step])
        if not len(where):
            continue
        low = where.min(axis=0)
        slots = pack.atlas_indices[start : start + step][tuple(where.T)][:, ::-1].astype(np.intp)
        (d, h, w), (z, y, x) = (size * (where.max(axis=0) + 1 - low)).tolist(), low.tolist()
        places = np.stack([(where - low) * size, slots * (size + 2) + 1], axis=1)
        pieces.append(Piece((d, h, w), (size, size, size), places, (start + z, y, x)))
    return pieces


def follows_grid(pack: Pack, atlas: np.ndarray) -> bool:
    """Whether the "grid" layout brings `atlas` back exactly: nothing outside of macroblocks, all padding a copy."""
    again = np.zeros_like(atlas)
    for piece in cut(pack, "grid", pack.block_size):
        piece.scatter(piece.gather(atlas), again)
    restore_padding(again, pack.atlas_indices, pack.block_size)
    return np.array_equal(atlas, again)


# --- The atlas out of the files of a pack ---

SETTINGS, STEPS = "codec_settings", "steps"
LIKED_PLANES = 128  # more than any codec of ours asks for, however shallow the atlas
NOTICED_S = 0.2  # how long Ctrl-C may wait
DECODING_THREADS = min(8, os.cpu_count() or 1)


def settings_for(pack: Pack, codec: Codec, quality: int | None) -> dict[str, Any]:
    """The codec_settings to write `pack` with."""
    layout, steps = codec.layout, EXACT
    if codec.default_quality is None and not isinstance(codec, PngCodec):
        # Without loss means the atlas voxel by voxel, even where it is not as it should be.
        layout = "grid" if layout == "grid" and all(follows_grid(pack, part) for part in pack.atlases) else "atlas"
        steps = steps_of(pack.atlases)
    settings: dict[str, Any] = {"layout": layout, "planes": codec.planes(layout, pack.block_size)}
    if steps != EXACT:
        settings[STEPS] = list(steps if steps.alpha > 1 else steps[:2])
    return settings if quality is None else {**settings, "quality": quality}


def encoding_jobs(pack: Pack, codec: Codec, settings: Mapping[str, Any]) -> list[Callable[[], list[tuple[str, bytes]]]]:
    """A call for each piece that gives its files, name and content."""

    def encode(number: int, piece: Piece) -> list[tuple[str, bytes]]:
        parts = to_counts([piece.gather(atlas) for atlas in pack.atlases], Steps(*settings.get(STEPS, EXACT)))
        files = codec.encode(parts, settings.get("quality", 0))
        return list(zip(codec.names(number, piece.shape, len(parts) > 1), files, strict=True))

    return [partial(encode, *each) for each in enumerate(cut(pack, settings["layout"], settings["planes"]))]


def png_channels(files: PackFiles, name: str, width: int, height: int, entries: str, unit: str) -> str:
    """The channels of a PNG. UserError where it is none of the size that `entries` of the JSON ask for."""
    with files.decoding(name):
        *found, channels = probe_png(files.head(name, PngCodec.header_bytes), files.sizes[name])
    if found != [width, height]:
        raise UserError(f"its size disagrees with the JSON's {entries}", where=files.where(name),
                        expected=f"{width}×{height} {unit}", found=f"{found[0]}×{found[1]}")  # fmt: skip
    return channels


def read_settings(outline: Pack, codec: Codec, where: str) -> tuple[Layout, int, Steps]:
    """Layout and planes of the pieces, and steps of their values, by the metadata of a pack. UserError where it lacks them."""
    if isinstance(codec, PngCodec):
        return codec.layout, PLANES_PER_IMAGE, EXACT
    settings = outline.metadata.get(SETTINGS)
    if not isinstance(settings, Mapping):
        what = f"snerg.{SETTINGS} is missing; {codec.name} cannot be decoded without it"
        raise UserError(what, where=where, remedy="copy the pack again")
    layout, planes, steps = settings.get("layout"), settings.get("planes"), settings.get(STEPS, [1, 1])
    step, whole = (outline.block_size, outline.grid_size[2]) if layout == "grid" else (1, len(outline.atlas_rgba))
    allowed = range(step, max(whole, LIKED_PLANES, outline.block_size + 2) + 1, step)
    known = (
        isinstance(steps, list) and len(steps) in (2, 3) and all(type(s) is int and 1 <= s <= MOST_STEP for s in steps)
    )
    if layout not in ("atlas", "grid") or type(planes) is not int or planes not in allowed or not known:
        expected = (
            f"layout atlas or grid, planes a multiple of {step} to {allowed[-1]}, two or three steps to {MOST_STEP}"
        )
        raise UserError(f"snerg.{SETTINGS} makes no sense", where=where, expected=expected, found=settings)
    return layout, planes, Steps(*steps)


def in_threads(job: Callable[[int], None], count: int) -> Iterator[int]:
    """Calls job(0) … job(count - 1) in threads that do not keep the program from ending; yields how many are done.

    Raises what one of them raises; no other begins then, nor where the caller takes no more.
    """
    with ThreadPool(max(min(DECODING_THREADS, count), 1)) as pool:
        ended = pool.imap_unordered(job, range(count))
        for done in range(1, count + 1):
            while True:  # asked again and again: Ctrl-C just before a wait begins would be noticed only after it
                with suppress(multiprocessing.TimeoutError):
                    ended.next(NOTICED_S)
                    break
            yield done
