"""Packs from disk: `load_pack` at once, or `open_pack` for an outline now and the atlas plane by plane.

What follows is for the published layout, PNG; other codecs store pieces (see scenepack.piece_files). Image k of a
part holds the atlas's z-planes 4k … 4k + 3, stacked vertically (see scenepack.codecs.png). Opening checks the JSON, the
indirection grid and the header of every image, so that nothing large is allocated on the word of one file alone;
decoding then runs in threads, straight into the atlas arrays.
Untidy packs (docs/format.md) are repaired with one PackWarning each; the rest is refused with a UserError.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from console import UserError
from console.atomic import recover_interrupted_write
from console.json_text import MOST_BYTES
from console.streams import one_line
from scenepack.blocks import grid_block_counts
from scenepack.budget import require_distinct, require_filled, require_memory
from scenepack.coarse import coarse_pack, order_of_groups
from scenepack.codecs import CodecError, PngCodec, codec_named, decode_png, probe_png
from scenepack.codecs.png import PNG_HEADER_BYTES, require_room
from scenepack.constants import EMPTY_BLOCK, PLANES_PER_IMAGE
from scenepack.files import INDICES_NAME, PARAMS_NAME, PackFiles, open_files
from scenepack.pack import Pack, warn
from scenepack.params import Params, parse_params
from scenepack.piece_files import PieceFiles

RGBA, FEATURE = "rgba", "feature"
DECODING_THREADS = min(8, os.cpu_count() or 1)

OnProgress = Callable[[int, int], None]
OnPreview = Callable[[Pack], None]


@dataclass(frozen=True)
class AtlasPlanes:
    """A decoded image.

    part: "rgba" or "feature". z: its first plane in the atlas. pixels: uint8 [n, H, W, 4], n at most 4.
    """

    part: str
    z: int
    pixels: np.ndarray


def load_pack(
    path: Path,
    *,
    on_progress: OnProgress | None = None,
    on_preview: OnPreview | None = None,
    on_begin: OnPreview | None = None,
) -> Pack:
    """Reads a pack, a folder or one .zip of it, completely.

    on_progress(done, total) is called in this thread after each of `total` images, and on_preview(pack) a few times
    before the end, with the same scene in coarser voxels (scenepack.coarse); on_begin(pack) before the first image, with its
    atlas still to be filled. Raises UserError where the pack cannot be opened; warns with PackWarning where it is untidy. A
    folder that is replaced meanwhile is read anew.
    """
    path = Path(path)
    for _ in range(3):
        before = _identity(path)
        try:
            with open_pack(path) as reader:
                pack = reader.read(on_progress, on_preview, on_begin)
        except UserError:
            if before is None or _identity(path) == before:
                raise
        else:
            if _identity(path) == before:
                return pack
    raise UserError(
        "keeps changing while it is read", where=path, remedy="wait until the other program has finished writing it"
    )


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
    memory and cannot be written. total: images to decode.
    """

    outline: Pack
    total: int

    def __init__(self, files: PackFiles) -> None:
        self.files = files
        self._notes: list[str] = []  # given only once it is clear that the pack opens
        try:
            text = files.read(PARAMS_NAME, MOST_BYTES)
            self.params: Params = parse_params(text, self._where(PARAMS_NAME), self._notes.append)
            self.codec = codec_named(self.params.format, self._where(PARAMS_NAME))
            width, height, depth = self.params.atlas_size
            self._groups = -(-depth // PLANES_PER_IMAGE)
            self._image_shape = (PLANES_PER_IMAGE * height, width, 4)
            indices = self._indices()
            used = np.count_nonzero(indices[..., 0] != EMPTY_BLOCK) * (self.params.block_size + 2) ** 3
            require_filled(self.params.atlas_size, int(used), self._where(PARAMS_NAME))
            self._pieces: PieceFiles | None = None
            self._present: dict[str, list[int]] = {}
            self._note_blocks()
            if isinstance(self.codec, PngCodec):
                self._note_counts(self.codec)
                self._present = {part: self._check_images(self.codec, part) for part in (RGBA, FEATURE)}
                self.outline = self._outline(indices, has_features=bool(self._present[FEATURE]))
            else:
                outline = self._outline(indices, has_features=True)
                self._pieces = PieceFiles(files, self.codec, outline, self._notes.append)
                self.outline = self._outline(indices, has_features=self._pieces.has_features)
        except BaseException:
            files.close()
            raise
        self.total = self._pieces.total if self._pieces else sum(len(groups) for groups in self._present.values())
        for note in self._notes:
            warn(note)

    def __enter__(self) -> PackReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self.files.close()

    def read(
        self,
        on_progress: OnProgress | None = None,
        on_preview: OnPreview | None = None,
        on_begin: OnPreview | None = None,
    ) -> Pack:
        """The whole pack; see load_pack."""
        depth, height, width = self.outline.atlas_rgba.shape[:3]
        whole = (self._groups * PLANES_PER_IMAGE, height, width, 4)
        parts = [RGBA] if self.outline.atlas_features is None else [RGBA, FEATURE]
        require_memory(len(parts) * int(np.prod(whole)), self.files.path)
        try:
            atlas = {part: (np.zeros if self._pieces else np.empty)(whole, np.uint8) for part in parts}
        except MemoryError as error:
            raise UserError(f"its atlas does not fit in memory ({error})", where=self.files.path) from error
        features = atlas[FEATURE][:depth] if FEATURE in atlas else None
        pack = replace(self.outline, atlas_rgba=atlas[RGBA][:depth], atlas_features=features)
        if on_begin is not None:
            on_begin(pack)
        known = np.full(depth, self._pieces is not None)  # of pieces: where nothing has arrived there are zeros
        groups, steps = order_of_groups(depth, pack.padded_block_size)
        if self._pieces:
            previews = {1, self.total // 4, self.total // 2}
            finished = self._pieces.fill(atlas[RGBA][:depth], _upto(atlas.get(FEATURE), depth), DECODING_THREADS)
        else:
            previews = {step * len(parts) for step in steps}
            finished = self._fill(lambda part, group: _group(atlas[part], group), groups, known)
        for done in finished:
            if on_progress is not None:
                on_progress(done, self.total)
            coarse = coarse_pack(pack, known) if on_preview and done in previews and done < self.total else None
            if on_preview is not None and coarse is not None:
                on_preview(coarse)
        return pack

    def _fill(self, target: Callable[[str, int], np.ndarray], groups: list[int], known: np.ndarray) -> Iterator[int]:
        """Decodes all images in the order of `groups` and marks planes that are `known` now; yields how many are done."""
        for done, (_, group, _) in enumerate(self._decoded(target, groups), 1):
            known[group * PLANES_PER_IMAGE : (group + 1) * PLANES_PER_IMAGE] = True
            yield done

    def planes(self) -> Iterator[AtlasPlanes]:
        """Decodes image by image, some ahead in threads, in the order rgba 0, feature 0, rgba 1, …

        Codecs that store something else than such images are decoded at once.
        """
        depth, height, width = self.outline.atlas_rgba.shape[:3]
        if self._pieces:
            pack = self.read()
            for z in range(0, depth, PLANES_PER_IMAGE):
                yield AtlasPlanes(RGBA, z, pack.atlas_rgba[z : z + PLANES_PER_IMAGE])
                if pack.atlas_features is not None:
                    yield AtlasPlanes(FEATURE, z, pack.atlas_features[z : z + PLANES_PER_IMAGE])
            return
        shape = (PLANES_PER_IMAGE, height, width, 4)
        for part, group, image in self._decoded(lambda _part, _group: np.empty(shape, np.uint8)):
            z = group * PLANES_PER_IMAGE
            yield AtlasPlanes(part, z, image[: depth - z])

    def _where(self, name: str) -> str:
        return f"{self.files.path}: {name}"

    def _decoded(
        self, target: Callable[[str, int], np.ndarray], order: Iterable[int] | None = None
    ) -> Iterator[tuple[str, int, np.ndarray]]:
        """Decodes each present image into target(part, group), uint8 [4, H, W, 4]; yields them, rgba before feature.

        order: of the groups; by default from the first to the last.
        """
        parts = [part for part in (RGBA, FEATURE) if self._present[part]]
        jobs = [(group, part) for group in order or range(self._groups) for part in parts]

        def decode(group: int, part: str) -> tuple[str, int, np.ndarray]:
            out = target(part, group)
            self._decode(part, group, out.reshape(self._image_shape))
            return part, group, out

        with ThreadPoolExecutor(DECODING_THREADS, "snerg-decode") as pool:
            waiting: deque[Future[tuple[str, int, np.ndarray]]] = deque()
            rest = iter(jobs)
            try:
                # Only a few ahead: a slow consumer must not make the whole atlas pile up decoded.
                waiting.extend(pool.submit(decode, *job) for job in islice(rest, 2 * DECODING_THREADS))
                while waiting:
                    result = waiting.popleft().result()
                    waiting.extend(pool.submit(decode, *job) for job in islice(rest, 1))
                    yield result
            finally:
                for future in waiting:
                    future.cancel()

    def _decode(self, part: str, group: int, out: np.ndarray) -> None:
        assert isinstance(self.codec, PngCodec)  # others go through PieceFiles
        names = self.codec.names(part, group)
        most = out.nbytes + (out.nbytes >> 3) + (1 << 20)  # no image format grows noise by more
        data = tuple(self.files.read(name, most) for name in names)
        try:
            self.codec.decode(data, out)
        except CodecError as error:
            raise self._undecodable(names[0], error) from error

    def _undecodable(self, name: str, error: CodecError) -> UserError:
        return UserError(
            f"cannot be decoded: {error}", where=self._where(name), remedy="copy the pack again, or bake it again"
        )

    def _indices(self) -> np.ndarray:
        """The indirection grid, uint8 [blocks z, blocks y, blocks x, 3], each index within the atlas."""
        params, where = self.params, self._where(INDICES_NAME)
        x, y, z = grid_block_counts(params.grid_size, params.block_size)
        try:
            first = self.files.head(INDICES_NAME, PNG_HEADER_BYTES)
            head = probe_png(first)
            require_room(first, self.files.sizes.get(INDICES_NAME, 0))
            if (head.width, head.height) != (x, z * y):
                raise UserError(
                    "its size disagrees with the JSON's grid and block_size",
                    where=where,
                    expected=f"{x}×{z * y} pixels",
                    found=f"{head.width}×{head.height}",
                )
            image = np.empty((z * y, x, 4), np.uint8)
            decode_png(self.files.read(INDICES_NAME, 2 * image.nbytes + (1 << 20)), image)
        except CodecError as error:
            raise self._undecodable(INDICES_NAME, error) from error
        indices = np.ascontiguousarray(image.reshape(z, y, x, 4)[..., :3])
        occupied = indices[..., 0] != EMPTY_BLOCK
        if not occupied.any():
            self._notes.append(f"{where}: every macroblock is empty; there is nothing to see")
            return indices
        fits = [side // (params.block_size + 2) for side in params.atlas_size]
        outside = occupied & np.any(indices >= np.array(fits), axis=-1)
        if outside.any():
            bz, by, bx = (int(i) for i in np.argwhere(outside)[0])
            raise UserError(
                f"{int(outside.sum())} macroblocks point outside of the atlas, such as ({bx}, {by}, {bz})",
                where=where,
                expected=f"blocks below {_triple(fits)}",
                found=_triple(indices[bz, by, bx].tolist()),
            )
        require_distinct(indices[occupied], where)
        return indices

    def _note_counts(self, codec: PngCodec) -> None:
        raw, where = self.params.raw, self._where(PARAMS_NAME)
        claimed = raw.get("num_slices")
        stored = 0
        while codec.names(RGBA, stored)[0] in self.files.sizes:
            stored += 1
        needed = self._groups
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
        raw, where = self.params.raw, self._where(PARAMS_NAME)
        fits = [size // (self.params.block_size + 2) for size in self.params.atlas_size]
        blocks = [raw.get(f"atlas_blocks_{axis}", "missing") for axis in "xyz"]
        if blocks != fits:
            problem = f"{where}: atlas_blocks_x/y/z are {_triple(blocks)}"
            self._notes.append(f"{problem}, the atlas holds {_triple(fits)}; its size is trusted")

    def _check_images(self, codec: PngCodec, part: str) -> list[int]:
        """Groups of `part` to decode, their headers checked; [] where there are no (complete) features."""
        names = [codec.names(part, group) for group in range(self._groups)]
        missing = [group[0] for group in names if not all(name in self.files.sizes for name in group)]
        if missing and part == FEATURE:
            # A diffuse pack has no use for features and may leave them out.
            if self.params.view_mlp is not None or len(missing) < len(names):
                problem = f"{self._where(missing[0])} is missing ({len(missing)} in all)"
                self._notes.append(f"{problem}; the pack is shown as diffuse")
            return []
        if missing:
            raise UserError(
                "is missing",
                where=self._where(missing[0]),
                expected=f"{len(names)} {part} images for the JSON's atlas_depth",
                found=f"{len(names) - len(missing)}",
                remedy="copy the pack again, or bake it again",
            )
        channels = {group[0]: self._check_header(codec, group[0]) for group in names}
        other = [name for name, layout in channels.items() if layout != "RGBA"]
        if other:
            problem = f"{self._where(other[0])} is {channels[other[0]]}, not RGBA ({len(other)} in all)"
            self._notes.append(f"{problem}; read as the PNG standard has it, with alpha 255 where there is none")
        return list(range(self._groups))

    def _check_header(self, codec: PngCodec, name: str) -> str:
        height, width = self._image_shape[:2]
        try:
            first = self.files.head(name, codec.header_bytes)
            head = codec.probe(first)
            require_room(first, self.files.sizes[name])
        except CodecError as error:
            raise self._undecodable(name, error) from error
        if (head.width, head.height) != (width, height):
            raise UserError(
                "its size disagrees with the JSON's atlas",
                where=self._where(name),
                expected=f"{width}×{height} pixels, {PLANES_PER_IMAGE} planes",
                found=f"{head.width}×{head.height}",
            )
        return head.channels

    def _outline(self, indices: np.ndarray, *, has_features: bool) -> Pack:
        params = self.params
        width, height, depth = params.atlas_size
        nothing = np.broadcast_to(np.uint8(0), (depth, height, width, 4))
        return Pack(
            voxel_size=params.voxel_size,
            min_xyz=params.min_xyz,
            grid_size=params.grid_size,
            block_size=params.block_size,
            atlas_indices=indices,
            atlas_rgba=nothing,
            atlas_features=nothing if has_features else None,
            view_mlp=params.view_mlp if has_features else None,
            worldspace_T_opengl=params.worldspace_T_opengl,
            ndc=params.ndc,
            input_width=params.input_camera[0],
            input_height=params.input_camera[1],
            input_focal=params.input_camera[2],
            params=params.raw,
        )


def _triple(values: list[Any]) -> str:
    return f"({', '.join(one_line(str(value), 40) for value in values)})"


def _group(atlas: np.ndarray, group: int) -> np.ndarray:
    return atlas[group * PLANES_PER_IMAGE : (group + 1) * PLANES_PER_IMAGE]


def _upto(atlas: np.ndarray | None, depth: int) -> np.ndarray | None:
    return None if atlas is None else atlas[:depth]
