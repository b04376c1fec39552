"""Packs from disk: `load_pack` at once, or `open_pack` for an outline now and the atlas later.

What follows is for the published layout, PNG; other codecs store pieces (see scenepack.piece_files). Image k of a
part holds the atlas's z-planes 4k … 4k + 3, stacked vertically (see scenepack.codecs.png). Opening checks the JSON, the
indirection grid and the header of every image, so that nothing large is allocated on the word of one file alone;
decoding then runs in threads, straight into the atlas arrays.
Untidy packs (docs/format.md) are repaired with one PackWarning each; the rest is refused with a UserError.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from console.atomic import recover_interrupted_write
from console.json_text import MOST_BYTES
from console.streams import one_line
from scenepack.blocks import grid_block_counts
from scenepack.coarse import coarse_pack, order_of_groups
from scenepack.codecs import CodecError, PngCodec, codec_named
from scenepack.codecs.png import PNG_HEADER_BYTES, decode_png, image_name, probe_png, require_room
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
from scenepack.pack import Pack, warn
from scenepack.params import parse_params
from scenepack.piece_files import PieceFiles, all_there, in_threads

RGBA, FEATURE = "rgba", "feature"
DECODING_THREADS = min(8, os.cpu_count() or 1)

OnProgress = Callable[[int, int], None]
OnPreview = Callable[[Pack], None]


def load_pack(path: Path, *, on_progress: OnProgress | None = None, on_preview: OnPreview | None = None) -> Pack:
    """Reads a pack, a folder or one .zip of it, completely.

    on_progress(done, total) is called in this thread after each of `total` images, and on_preview(pack) a few times
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
    memory and cannot be written. total: images to decode. pieces: of codecs that store pieces.
    """

    outline: Pack
    total: int
    pieces: PieceFiles | None

    def __init__(self, files: PackFiles) -> None:
        self.files = files
        self._notes: list[str] = []  # given only once it is clear that the pack opens
        try:
            text = files.read(PARAMS_NAME, MOST_BYTES)
            self.outline, format = parse_params(text, self.files.where(PARAMS_NAME), self._notes.append)
            self.codec = codec_named(format, self.files.where(PARAMS_NAME))
            depth, height, width = self.outline.atlas_rgba.shape[:3]
            self._groups = -(-depth // PLANES_PER_IMAGE)
            self._image_shape = (PLANES_PER_IMAGE * height, width, 4)
            self.outline = replace(self.outline, atlas_indices=self._indices())
            used = np.count_nonzero(self.outline.occupied) * self.outline.padded_block_size**3
            require_filled((width, height, depth), int(used), self.files.where(PARAMS_NAME))
            self.pieces = None
            self._present: dict[str, list[int]] = {}
            self._note_blocks()
            if isinstance(self.codec, PngCodec):
                self._note_counts()
                self._present = {part: self._check_images(part) for part in (RGBA, FEATURE)}
                has_features = bool(self._present[FEATURE])
            else:
                self.pieces = PieceFiles(files, self.codec, self.outline, self._notes.append)
                has_features = self.pieces.has_features
            if not has_features:
                self.outline = replace(self.outline, atlas_features=None, view_mlp=None)
        except BaseException:
            files.close()
            raise
        self.total = self.pieces.total if self.pieces else sum(len(groups) for groups in self._present.values())
        for note in self._notes:
            warn(note)

    def __enter__(self) -> PackReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.files.close()

    def read(self, on_progress: OnProgress | None = None, on_preview: OnPreview | None = None) -> Pack:
        """The whole pack; see load_pack."""
        depth, height, width = self.outline.atlas_rgba.shape[:3]
        whole = (self._groups * PLANES_PER_IMAGE, height, width, 4)
        parts = [RGBA] if self.outline.atlas_features is None else [RGBA, FEATURE]
        require_memory(len(parts) * int(np.prod(whole)), self.files.path)
        try:
            atlas = {part: (np.zeros if self.pieces else np.empty)(whole, np.uint8) for part in parts}
        except MemoryError as error:
            raise UserError(f"its atlas does not fit in memory ({error})", where=self.files.path) from error
        features = atlas[FEATURE][:depth] if FEATURE in atlas else None
        pack = replace(self.outline, atlas_rgba=atlas[RGBA][:depth], atlas_features=features)
        known = np.full(depth, self.pieces is not None)  # of pieces: where nothing has arrived there are zeros
        groups, steps = order_of_groups(depth, pack.padded_block_size)
        if self.pieces:
            previews = {1, self.total // 4, self.total // 2}
            finished = self.pieces.fill(atlas[RGBA][:depth], features, DECODING_THREADS)
        else:
            previews = {step * len(parts) for step in steps}
            finished = self._fill(atlas, groups, known)
        for done in finished:
            if on_progress is not None:
                on_progress(done, self.total)
            coarse = coarse_pack(pack, known) if on_preview and done in previews and done < self.total else None
            if on_preview is not None and coarse is not None:
                on_preview(coarse)
        return pack

    def _fill(self, atlas: Mapping[str, np.ndarray], groups: list[int], known: np.ndarray) -> Iterator[int]:
        """Decodes all images in the order of `groups`, rgba before feature, and marks planes that are `known` then; yields how
        many are done.
        """
        jobs = [(group, part) for group in groups for part in atlas]
        arrived: set[tuple[int, str]] = set()

        def decode(number: int) -> None:
            group, part = jobs[number]
            planes = slice(group * PLANES_PER_IMAGE, (group + 1) * PLANES_PER_IMAGE)
            self._decode(image_name(part, group), atlas[part][planes].reshape(self._image_shape))
            arrived.add((group, part))
            known[planes] = all((group, each) in arrived for each in atlas)

        return in_threads(decode, len(jobs), DECODING_THREADS)

    def _decode(self, name: str, out: np.ndarray) -> None:
        most = out.nbytes + (out.nbytes >> 3) + (1 << 20)  # no image format grows noise by more
        try:
            decode_png(self.files.read(name, most), out)
        except CodecError as error:
            raise self.files.undecodable(name, error) from error

    def _indices(self) -> np.ndarray:
        """The indirection grid, uint8 [blocks z, blocks y, blocks x, 3], each index within the atlas."""
        pack, where = self.outline, self.files.where(INDICES_NAME)
        x, y, z = grid_block_counts(pack.grid_size, pack.block_size)
        self._check_header(INDICES_NAME, x, z * y, "grid and block_size", "pixels")
        image = np.empty((z * y, x, 4), np.uint8)
        self._decode(INDICES_NAME, image)
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

    def _note_counts(self) -> None:
        raw, where = self.outline.params, self.files.where(PARAMS_NAME)
        claimed, needed = raw.get("num_slices"), self._groups
        stored = next(n for n in itertools.count() if image_name(RGBA, n) not in self.files.sizes)
        if stored > needed:
            self._notes.append(
                f"{self.files.path}: {stored} rgba images, atlas_depth needs {needed}; the rest is ignored"
            )
        if claimed != needed:
            found = "missing" if claimed is None else one_line(str(claimed), 40)
            self._notes.append(
                f"{where}: num_slices is {found}, atlas_depth needs {needed} images; atlas_depth is trusted"
            )

    def _note_blocks(self) -> None:
        raw, where = self.outline.params, self.files.where(PARAMS_NAME)
        fits = list(self.outline.atlas_blocks)
        blocks = [raw.get(f"atlas_blocks_{axis}", "missing") for axis in "xyz"]
        if blocks != fits:
            problem = f"{where}: atlas_blocks_x/y/z are {_triple(blocks)}"
            self._notes.append(f"{problem}, the atlas holds {_triple(fits)}; its size is trusted")

    def _check_images(self, part: str) -> list[int]:
        """Groups of `part` to decode, their headers checked; [] where there are no (complete) features."""
        names = [image_name(part, group) for group in range(self._groups)]
        if part == FEATURE and not all_there(self.files, names, self.outline, self._notes.append):
            return []
        missing = [name for name in names if name not in self.files.sizes]
        if missing:
            expected, found = f"{len(names)} {part} images for the JSON's atlas_depth", f"{len(names) - len(missing)}"
            raise UserError("is missing", where=self.files.where(missing[0]), expected=expected, found=found,
                            remedy=COPY_OR_BAKE)  # fmt: skip
        (height, width), whole = self._image_shape[:2], f"pixels, {PLANES_PER_IMAGE} planes"
        channels = {name: self._check_header(name, width, height, "atlas", whole) for name in names}
        other = [name for name, layout in channels.items() if layout != "RGBA"]
        if other:
            problem = f"{self.files.where(other[0])} is {channels[other[0]]}, not RGBA ({len(other)} in all)"
            self._notes.append(f"{problem}; read as the PNG standard has it, with alpha 255 where there is none")
        return list(range(self._groups))

    def _check_header(self, name: str, width: int, height: int, entries: str, unit: str) -> str:
        """The channels of a PNG. UserError where it is none of the size that `entries` of the JSON ask for."""
        try:
            first = self.files.head(name, PNG_HEADER_BYTES)
            head = probe_png(first)
            require_room(first, self.files.sizes.get(name, 0))
        except CodecError as error:
            raise self.files.undecodable(name, error) from error
        if (head.width, head.height) != (width, height):
            raise UserError(f"its size disagrees with the JSON's {entries}", where=self.files.where(name),
                            expected=f"{width}×{height} {unit}", found=f"{head.width}×{head.height}")  # fmt: skip
        return head.channels


def _triple(values: list[Any]) -> str:
    return f"({', '.join(one_line(str(value), 40) for value in values)})"
