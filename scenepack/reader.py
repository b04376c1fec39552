"""Packs from disk: `load_pack` at once, or `open_pack` for an outline now and the atlas later.

Opening checks the JSON, the indirection grid and the header of every file of the atlas (scenepack.piece_files), so that nothing
large is allocated on the word of one file alone; decoding then runs in threads.
Untidy packs (docs/format.md) are repaired with one PackWarning each; the rest is refused with a UserError.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from console.atomic import recover_interrupted_write
from console.json_text import MOST_BYTES
from console.streams import one_line
from scenepack.blocks import grid_block_counts
from scenepack.coarse import coarse_pack
from scenepack.codecs import CodecError, PngCodec, codec_named
from scenepack.codecs.images import decode_png
from scenepack.constants import EMPTY_BLOCK, PLANES_PER_IMAGE
from scenepack.files import (
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
from scenepack.piece_files import PieceFiles, png_channels

OnProgress = Callable[[int, int], None]
OnPreview = Callable[[Pack], object]


def load_pack(path: Path, *, on_progress: OnProgress | None = None, on_preview: OnPreview | None = None) -> Pack:
    """Reads a pack, a folder or one .zip of it, completely.

    on_progress(done, total) is called in this thread after each of `total` pieces, and on_preview(pack) a few times
    before the end, with the same scene in coarser voxels (scenepack.coarse). Raises UserError where the pack cannot be opened;
    warns with PackWarning where it is untidy. A folder that is replaced meanwhile is read anew.
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


def open_pack(path: Path) -> PackReader:
    """Checks all but the pixels of a pack, at once; raises and warns like load_pack. Close the reader."""
    path = Path(path)
    recover_interrupted_write(path)
    return PackReader(open_files(path))


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


class PackReader:
    """An open pack whose images are not decoded yet; a context manager.

    outline: the Pack with everything but the atlas, whose arrays have their true shape, hold zeros, take no
    memory and cannot be written. total: pieces to decode.
    """

    def __init__(self, files: PackFiles) -> None:
        self.files = files
        self._notes: list[str] = []  # given only once it is clear that the pack opens
        try:
            text, where = files.read(PARAMS_NAME, MOST_BYTES), files.where(PARAMS_NAME)
            self.outline, format = parse_params(text, where, self._notes.append)
            codec = codec_named(format, where)
            self.outline = replace(self.outline, atlas_indices=self._indices())
            used = np.count_nonzero(self.outline.occupied) * self.outline.padded_block_size**3
            require_filled(self.outline.atlas_rgba.shape[:3], int(used), where)
            self._note_claims(isinstance(codec, PngCodec))
            self.pieces = PieceFiles(files, codec, self.outline, self._notes.append)
            if not self.pieces.has_features:
                self.outline = replace(self.outline, atlas_features=None, view_mlp=None)
        except BaseException:
            files.close()
            raise
        self.total = self.pieces.total
        for note in self._notes:
            warnings.warn(PackWarning(note), stacklevel=2)

    def __enter__(self) -> PackReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.files.close()

    def read(self, on_progress: OnProgress | None = None, on_preview: OnPreview | None = None) -> Pack:
        """The whole pack; see load_pack."""
        depth, height, width = self.outline.atlas_rgba.shape[:3]
        whole, parts = (self._groups * PLANES_PER_IMAGE, height, width, 4), len(self.outline.atlases)
        require_memory(parts * int(np.prod(whole)), self.files.path)
        try:
            atlases = [np.zeros(whole, np.uint8) for _ in range(parts)]
        except MemoryError as error:
            raise UserError(f"its atlas does not fit in memory ({error})", where=self.files.path) from error
        features = atlases[1][:depth] if parts > 1 else None
        pack, pieces = replace(self.outline, atlas_rgba=atlases[0][:depth], atlas_features=features), self.pieces
        for done in pieces.fill(atlases):
            if on_progress is not None:
                on_progress(done, self.total)
            if on_preview is not None and done in pieces.previews and done < self.total:
                coarse = coarse_pack(pack, pieces.known)
                if coarse is not None:
                    on_preview(coarse)
        return pack

    @property
    def _groups(self) -> int:
        return -(-len(self.outline.atlas_rgba) // PLANES_PER_IMAGE)

    def _indices(self) -> np.ndarray:
        """The indirection grid, uint8 [blocks z, blocks y, blocks x, 3], each index within the atlas."""
        pack, where = self.outline, self.files.where(INDICES_NAME)
        x, y, z = grid_block_counts(pack.grid_size, pack.block_size)
        png_channels(self.files, INDICES_NAME, x, z * y, "grid and block_size", "pixels")
        image = np.empty((z * y, x, 4), np.uint8)
        try:
            decode_png(self.files.read(INDICES_NAME, 2 * image.nbytes + (1 << 20)), image)
        except CodecError as error:
            raise self.files.undecodable(INDICES_NAME, error) from error
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

    def _note_claims(self, is_png: bool) -> None:
        """Notes what the JSON claims and the atlas refutes: how many blocks it has and, of PNG, images."""
        raw, where, note = self.outline.params, self.files.where(PARAMS_NAME), self._notes.append
        blocks, fits = [raw.get(f"atlas_blocks_{axis}", "missing") for axis in "xyz"], list(self.outline.atlas_blocks)
        if blocks != fits:
            problem = f"{where}: atlas_blocks_x/y/z are {_triple(blocks)}"
            note(f"{problem}, the atlas holds {_triple(fits)}; its size is trusted")
        if not is_png:
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
