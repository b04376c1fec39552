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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.pool import ThreadPool
from typing import Any

import numpy as np

from console import UserError
from scenepack.blocks import data_voxels, restore_padding
from scenepack.coarse import order_of_groups
from scenepack.codecs import Codec, CodecError, PngCodec
from scenepack.codecs.base import Layout, Shape, decoding
from scenepack.codecs.decoder_sandbox import Decoders
from scenepack.codecs.images import decode_png, probe_png
from scenepack.codecs.quantisation import EXACT, MOST_STEP, Steps, from_counts, steps_of, to_counts
from scenepack.constants import PLANES_PER_IMAGE
from scenepack.files import COPY_OR_BAKE, PARAMS_NAME, PackFiles, require_memory
from scenepack.pack import Pack


@dataclass(frozen=True)
class AtlasPiece:
    """Planes z0 … z0 + shape[0] of the atlas [D, H, W, 4]; those past its end are zeros."""

    z0: int
    shape: Shape

    @property
    def planes(self) -> slice:
        return slice(self.z0, self.z0 + self.shape[0])

    def gather(self, atlas: np.ndarray) -> np.ndarray:
        planes = atlas[self.planes]
        return np.pad(planes, [(0, self.shape[0] - len(planes)), (0, 0), (0, 0), (0, 0)])

    def scatter(self, values: np.ndarray, atlas: np.ndarray) -> None:
        target = atlas[self.planes]
        target[...] = values[: len(target)]


@dataclass(frozen=True)
class GridPiece:
    """Layers of the grid."""

    shape: Shape
    block_size: int
    corner: Shape  # where it begins in the grid (z, y, x), in blocks
    where: np.ndarray  # int [n, 3]: the macroblocks' places (z, y, x) in the piece, in blocks
    slots: np.ndarray  # int [n, 3]: theirs (x, y, z) in the atlas

    def gather(self, atlas: np.ndarray) -> np.ndarray:
        values = np.zeros((*self.shape, atlas.shape[3]), np.uint8)
        for inside, data in self._places():
            values[inside] = atlas[data]
        return values

    def scatter(self, values: np.ndarray, atlas: np.ndarray) -> None:
        for inside, data in self._places():
            atlas[data] = values[inside]

    def _places(self) -> list[tuple[tuple[slice, ...], tuple[slice, ...]]]:
        size = self.block_size
        return [
            (tuple(slice(i * size, (i + 1) * size) for i in block), data_voxels(slot, size))
            for block, slot in zip(self.where.tolist(), self.slots, strict=True)
        ]


# gather() takes its voxels from an atlas; scatter() writes them back, each piece's to others
Piece = AtlasPiece | GridPiece


def cut(pack: Pack, layout: Layout, planes: int) -> list[Piece]:
    """All pieces of a pack, or of its outline; `planes` in each, but fewer in the last of the "grid" layout."""
    depth, height, width = pack.atlas_rgba.shape[:3]
    if layout == "atlas":
        return [AtlasPiece(z, (planes, height, width)) for z in range(0, depth, planes)]
    size = pack.block_size
    step = planes // size
    pieces: list[Piece] = []
    for start in range(0, pack.occupied.shape[0], step):
        where = np.argwhere(pack.occupied[start : start + step])
        if not len(where):
            continue
        low = where.min(axis=0)
        counts = where.max(axis=0) + 1 - low
        slots = pack.atlas_indices[start : start + step][tuple(where.T)].astype(np.intp)
        (d, h, w), (z, y, x) = (int(n) * size for n in counts), low.tolist()
        pieces.append(GridPiece((d, h, w), size, (start + z, y, x), where - low, slots))
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
        steps = steps_of(pack.atlas_rgba, pack.atlas_features)
    settings: dict[str, Any] = {"layout": layout, "planes": codec.planes(layout, pack.block_size)}
    if steps != EXACT:
        settings[STEPS] = list(steps if steps.alpha > 1 else steps[:2])
    return settings if quality is None else {**settings, "quality": quality}


def encoding_jobs(pack: Pack, codec: Codec, settings: Mapping[str, Any]) -> list[Callable[[], list[tuple[str, bytes]]]]:
    """A call for each piece that gives its files, name and content."""

    def encode(number: int, piece: Piece) -> list[tuple[str, bytes]]:
        features = None if pack.atlas_features is None else piece.gather(pack.atlas_features)
        rgba, features = to_counts(piece.gather(pack.atlas_rgba), features, Steps(*settings.get(STEPS, EXACT)))
        files = codec.encode(rgba, features, settings.get("quality", 0))
        return list(zip(codec.names(number, piece.shape, features is not None), files, strict=True))

    return [partial(encode, *each) for each in enumerate(cut(pack, settings["layout"], settings["planes"]))]


def png_channels(files: PackFiles, name: str, width: int, height: int, entries: str, unit: str) -> str:
    """The channels of a PNG. UserError where it is none of the size that `entries` of the JSON ask for."""
    try:
        *found, channels = probe_png(files.head(name, PngCodec.header_bytes), files.sizes[name])
    except CodecError as error:
        raise files.undecodable(name, error) from error
    if found != [width, height]:
        raise UserError(f"its size disagrees with the JSON's {entries}", where=files.where(name),
                        expected=f"{width}×{height} {unit}", found=f"{found[0]}×{found[1]}")  # fmt: skip
    return channels


class PieceFiles:
    """The pieces of an open pack, not decoded yet. has_features: whether all feature files are there.

    outline: its atlas arrays have their true shape and hold nothing. note(line) is called for what is untidy; UserError
    where files are missing or their headers disagree with the JSON.
    previews: after how many pieces there is something new to see (scenepack.coarse). known: bool [D], planes of the atlas that
    fill() has decoded; in the "grid" layout all, for there are zeros where nothing has arrived.
    """

    def __init__(self, files: PackFiles, codec: Codec, outline: Pack, note: Callable[[str], None]) -> None:
        self.files, self.codec, self.outline = files, codec, outline
        self._layout, planes, self.steps = read_settings(outline, codec, files.where(PARAMS_NAME))
        self.pieces = cut(outline, self._layout, planes)
        self.total = len(self.pieces)
        depth = len(outline.atlas_rgba)
        self._order, self.previews = list(range(self.total)), [1, self.total // 4, self.total // 2]
        if self._layout == "atlas" and planes == PLANES_PER_IMAGE:
            self._order, self.previews = order_of_groups(depth, outline.padded_block_size)
        self.known = np.full(depth, self._layout == "grid")
        largest = max((int(np.prod(piece.shape)) * 4 for piece in self.pieces), default=0)
        require_memory(2 * largest, files.path)  # rgba and features of one piece, beside the atlas
        shapes = [piece.shape for piece in self.pieces]
        always, every = ([codec.names(*each, features) for each in enumerate(shapes)] for features in (False, True))
        needed = [name for names in always for name in names]
        if missing := [name for name in needed if name not in files.sizes]:
            raise UserError("is missing", where=files.where(missing[0]), expected=f"{len(needed)} files of the atlas",
                            found=len(needed) - len(missing), remedy=COPY_OR_BAKE)  # fmt: skip
        features = [name for names in every for name in names if name not in set(needed)]
        missing = [name for name in features if name not in files.sizes]
        # A diffuse pack has no use for features, and may leave all out.
        if missing and (outline.view_mlp is not None or len(missing) < len(features)):
            note(f"{files.where(missing[0])} is missing ({len(missing)} in all); the pack is shown as diffuse")
        # A pack without any macroblock may have no files to tell by.
        self.has_features = not missing if features else outline.view_mlp is not None
        self.names = every if self.has_features else always
        self._check(note)

    def _check(self, note: Callable[[str], None]) -> None:
        other: dict[str, str] = {}
        for names, piece in zip(self.names, self.pieces, strict=True):
            d, h, w = piece.shape
            for name in names:
                if isinstance(self.codec, PngCodec):
                    channels = png_channels(self.files, name, w, d * h, "atlas", f"pixels, {d} planes")
                    other |= {} if channels == "RGBA" else {name: channels}
                    continue
                try:
                    self.codec.check(name, self.files.head(name, self.codec.header_bytes), piece.shape)
                except CodecError as error:
                    raise self.files.undecodable(name, error) from error
        if other:
            name, channels = next(iter(other.items()))
            note(f"{self.files.where(name)} is {channels}, not RGBA ({len(other)} in all); read as the PNG standard has it, "
                 "with alpha 255 where there is none")  # fmt: skip

    def fill(self, atlases: Sequence[np.ndarray]) -> Iterator[int]:
        """Decodes all pieces into zeroed rgba and features [D, H, W, 4], D a multiple of four; yields how many are done."""
        decoders = Decoders()

        def decode(job: int) -> None:
            number = self._order[job]
            piece, names = self.pieces[number], self.names[number]
            most = 2 * int(np.prod(piece.shape)) * 4 + (1 << 20)  # no format grows noise by more
            data = {name: self.files.read(name, most) for name in names}
            try:
                if isinstance(piece, AtlasPiece) and isinstance(self.codec, PngCodec):
                    for name, atlas in zip(names, atlases, strict=True):
                        with decoding(name):
                            decode_png(data[name], atlas[piece.planes].reshape(-1, *atlas.shape[2:]))
                else:
                    decoded = decoders.decode(self.codec.name, data, names, piece.shape, self.has_features)
                    for values, atlas in zip(from_counts(*decoded, self.steps), atlases, strict=False):
                        if values is not None:
                            piece.scatter(values, atlas)
            except CodecError as error:
                raise self.files.undecodable(error.file or names[0], error) from error
            if isinstance(piece, AtlasPiece):
                self.known[piece.planes] = True

        with closing(decoders):
            yield from in_threads(decode, self.total)
        # Left out of the grid's planes; lossy codecs make a copy differ from its original, which shows as a seam.
        if self._layout == "grid" or self.codec.default_quality is not None:
            for atlas in atlases:
                restore_padding(atlas, self.outline.atlas_indices, self.outline.block_size)


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
