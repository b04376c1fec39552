"""Packs from disk: `load_pack` at once, or `open_pack` for an outline now and the atlas later.

Opening checks the JSON, the indirection grid and the header of every file of the atlas, so that nothing
large is allocated on the word of one file alone; decoding then runs in threads.
Untidy packs (docs/format.md) are repaired with one PackWarning each; the rest is refused with a UserError.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError, notify
from console.atomic import recover_interrupted_write
from console.json_text import MOST_BYTES
from console.streams import one_line
from scenepack.blocks import grid_block_counts, restore_pack_padding
from scenepack.coarse import coarse_pack, order_of_groups
from scenepack.codecs import PngCodec, codec_named
from scenepack.codecs.decoder_sandbox import Decoders
from scenepack.codecs.images import decode_png
from scenepack.codecs.quantisation import from_counts
from scenepack.constants import EMPTY_BLOCK, PLANES_PER_IMAGE
from scenepack.files import (
    COPY_OR_BAKE,
    INDICES_NAME,
    PARAMS_NAME,
    PackFiles,
    open_files,
    require_distinct,
    require_filled,
    require_memory,
)
from scenepack.pack import Pack, PackWarning
from scenepack.params import parse_params
from scenepack.piece_files import cut, in_threads, png_channels, read_settings

OnProgress = Callable[[int, int], None]
OnPreview = Callable[[Pack], object]


def load_pack(path: Path, *, on_progress: OnProgress | None = None, on_preview: OnPreview | None = None) -> Pack:
    """Reads a pack, a folder or one .zip of it, completely.

    on_progress(done, total) is called in this thread after each of `total` pieces, and on_preview(pack) a few times, the last
    of them at the end, with the same scene in coarser voxels (scenepack.coarse). Raises UserError where the pack cannot be
    opened; warns with PackWarning where it is untidy. A folder that is replaced meanwhile is read anew.
    """
    path = Path(path)
    for _ in range(3):
        before = _identity(path)
        try:
            with open_pack(path) as reader:
                pack = reader.read(on_progress, on_preview)
        except UserError:
            if before is None or _identity(path) == before:
                raise
        else:
            if _identity(path) == before:
                return pack
    remedy = "wait until the other program has finished writing it"
    raise UserError("keeps changing while it is read", where=path, remedy=remedy)


@contextmanager
def open_pack(path: Path) -> Iterator[PackReader]:
    """Checks all but the pixels of a pack, at once; raises and warns like load_pack."""
    recover_interrupted_write(path)
    with closing(open_files(path)) as files:
        yield PackReader(files)


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


class PackReader:
    """An open pack whose images are not decoded yet.

    outline: the Pack with everything but the atlas, whose arrays have their true shape, hold zeros, take no
    memory and cannot be written. layout, pieces, names: what is to decode, and the files of each; total: how many.
    """

    def __init__(self, files: PackFiles) -> None:
        self.files = files
        self._notes: list[str] = []  # given only once it is clear that the pack opens
        text, where = files.read(PARAMS_NAME, MOST_BYTES), files.where(PARAMS_NAME)
        self.outline, format = parse_params(text, where, self._notes.append)
        self.codec = codec_named(format, where)
        self.outline = replace(self.outline, atlas_indices=self._indices())
        used = np.count_nonzero(self.outline.occupied) * self.outline.padded_block_size**3
        require_filled(self.outline.atlas_rgba.shape[:3], int(used), where)
        self._groups = -(-len(self.outline.atlas_rgba) // PLANES_PER_IMAGE)  # of four planes of the atlas
        self._note_claims()
        self.layout, self._planes, self.steps = read_settings(self.outline, self.codec, where)
        self.pieces = cut(self.outline, self.layout, self._planes)
        self.total = len(self.pieces)
        largest = max((int(np.prod(piece.shape)) * 4 for piece in self.pieces), default=0)
        require_memory(2 * largest, files.path)  # rgba and features of one piece, beside the atlas
        self.names = self._names()
        self._check_headers()
        for note in self._notes:
            notify(PackWarning(note))

    def read(self, on_progress: OnProgress | None = None, on_preview: OnPreview | None = None) -> Pack:
        """The whole pack; see load_pack."""
        depth, height, width = self.outline.atlas_rgba.shape[:3]
        whole, parts = (self._groups * PLANES_PER_IMAGE, height, width, 4), len(self.outline.atlases)
        require_memory(parts * int(np.prod(whole)), self.files.path)
        atlases = [np.zeros(whole, np.uint8) for _ in range(parts)]
        features = atlases[1][:depth] if parts > 1 else None
        pack = replace(self.outline, atlas_rgba=atlases[0][:depth], atlas_features=features)
        order, previews = list(range(self.total)), [1, self.total // 4, self.total // 2]
        if self.layout == "atlas" and self._planes == PLANES_PER_IMAGE:
            order, previews = order_of_groups(depth, pack.padded_block_size)
        if self.total > 1:
            previews.append(self.total)  # it is shown until all voxels are on the GPU
        # Planes that are decoded; in the "grid" layout all count, for there are zeros where nothing has arrived.
        known, decoders = np.full(depth, self.layout == "grid"), Decoders()

        def decode(job: int) -> None:
            self._decode(order[job], atlases, decoders)
            if self.layout == "atlas":
                for _, (planes, *_) in self.pieces[order[job]].boxes():
                    known[planes] = True

        with closing(decoders):
            for done in in_threads(decode, self.total):
                if on_progress is not None:
                    on_progress(done, self.total)
                if on_preview is not None and done in previews:
                    coarse = coarse_pack(pack, known)
                    if coarse is not None:
                        on_preview(coarse)
        # Left out of the grid's planes; lossy codecs make a copy differ from its original, which shows as a seam.
        if self.layout == "grid" or self.codec.default_quality is not None:
            restore_pack_padding(pack)
        return pack

    def _decode(self, number: int, atlases: Sequence[np.ndarray], decoders: Decoders) -> None:
        """Decodes a piece into zeroed rgba and features [D, H, W, 4], D a multiple of four."""
        piece, names = self.pieces[number], self.names[number]
        most = 2 * int(np.prod(piece.shape)) * 4 + (1 << 20)  # no format grows noise by more
        data = {name: self.files.read(name, most) for name in names}
        if isinstance(self.codec, PngCodec):
            first = number * PLANES_PER_IMAGE
            for name, atlas in zip(names, atlases, strict=True):
                with self.files.decoding(name):
                    decode_png(data[name], atlas[first : first + PLANES_PER_IMAGE].reshape(-1, *atlas.shape[2:]))
            return
        with self.files.decoding(names[0]):
            decoded = decoders.decode(self.codec.name, data, names, piece.shape, len(atlases) > 1)
        for values, atlas in zip(from_counts(decoded, self.steps), atlases, strict=True):
            piece.scatter(values, atlas)

    def _names(self) -> list[tuple[str, ...]]:
        """The files of each piece. Where those of features are missing, the outline becomes diffuse."""
        shapes = [piece.shape for piece in self.pieces]
        always, every = ([self.codec.names(*each, has) for each in enumerate(shapes)] for has in (False, True))
        needed = [name for names in always for name in names]
        if missing := [name for name in needed if name not in self.files.sizes]:
            raise UserError("is missing", where=self.files.where(missing[0]), expected=f"{len(needed)} files of the atlas",
                            found=len(needed) - len(missing), remedy=COPY_OR_BAKE)  # fmt: skip
        features = [name for few, names in zip(always, every, strict=True) for name in names[len(few) :]]
        missing = [name for name in features if name not in self.files.sizes]
        # A diffuse pack has no use for features, and may leave all out.
        if missing and (self.outline.view_mlp is not None or len(missing) < len(features)):
            first = self.files.where(missing[0])
            self._notes.append(f"{first} is missing ({len(missing)} in all); the pack is shown as diffuse")
        # A pack without any macroblock may have no files to tell by.
        if missing if features else self.outline.view_mlp is None:
            self.outline = replace(self.outline, atlas_features=None, view_mlp=None)
            return always
        return every

    def _check_headers(self) -> None:
        other: dict[str, str] = {}
        for names, piece in zip(self.names, self.pieces, strict=True):
            d, h, w = piece.shape
            for name in names:
                if isinstance(self.codec, PngCodec):
                    channels = png_channels(self.files, name, w, d * h, "atlas", f"pixels, {d} planes")
                    other |= {} if channels == "RGBA" else {name: channels}
                    continue
                with self.files.decoding(name):
                    self.codec.check(name, self.files.head(name, self.codec.header_bytes), piece.shape)
        if other:
            name, channels = next(iter(other.items()))
            problem = f"{self.files.where(name)} is {channels}, not RGBA ({len(other)} in all)"
            self._notes.append(f"{problem}; read as the PNG standard has it, with alpha 255 where there is none")

    def _indices(self) -> np.ndarray:
        """The indirection grid, uint8 [blocks z, blocks y, blocks x, 3], each index within the atlas."""
        pack, where = self.outline, self.files.where(INDICES_NAME)
        x, y, z = grid_block_counts(pack.grid_size, pack.block_size)
        png_channels(self.files, INDICES_NAME, x, z * y, "grid and block_size", "pixels")
        image = np.empty((z * y, x, 4), np.uint8)
        data = self.files.read(INDICES_NAME, 2 * image.nbytes + (1 << 20))
        with self.files.decoding(INDICES_NAME):
            decode_png(data, image)
        indices = np.ascontiguousarray(image.reshape(z, y, x, 4)[..., :3])
        occupied = indices[..., 0] != EMPTY_BLOCK
        if not occupied.any():
            self._notes.append(f"{where}: every macroblock is empty; there is nothing to see")
            return indices
        fits = list(pack.atlas_blocks)
        outside = occupied & np.any(indices >= np.array(fits), axis=-1)
        if outside.any():
            bz, by, bx = (int(i) for i in np.argwhere(outside)[0])
            what = f"{int(outside.sum())} macroblocks point outside of the atlas, such as ({bx}, {by}, {bz})"
            raise UserError(what, where=where, expected=f"blocks below {_triple(fits)}",
                            found=_triple(indices[bz, by, bx].tolist()))  # fmt: skip
        require_distinct(indices[occupied], where)
        return indices

    def _note_claims(self) -> None:
        """Notes what the JSON claims and the atlas refutes: how many blocks it has and, of PNG, images."""
        raw, where, note = self.outline.params, self.files.where(PARAMS_NAME), self._notes.append
        blocks, fits = [raw.get(f"atlas_blocks_{axis}", "missing") for axis in "xyz"], list(self.outline.atlas_blocks)
        if blocks != fits:
            problem = f"{where}: atlas_blocks_x/y/z are {_triple(blocks)}"
            note(f"{problem}, the atlas holds {_triple(fits)}; its size is trusted")
        if not isinstance(self.codec, PngCodec):
            return
        claimed, needed = raw.get("num_slices"), self._groups
        stored = next(n for n in itertools.count() if f"rgba_{n:03d}.png" not in self.files.sizes)
        if stored > needed:
            note(f"{self.files.path}: {stored} rgba images, atlas_depth needs {needed}; the rest is ignored")
        if claimed != needed:
            found = "missing" if claimed is None else one_line(str(claimed), 40)
            note(f"{where}: num_slices is {found}, atlas_depth needs {needed} images; atlas_depth is trusted")


def _triple(values: list[Any]) -> str:
    return f"({', '.join(one_line(str(value), 40) for value in values)})"
