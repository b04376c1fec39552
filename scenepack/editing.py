"""Choosing voxels of a pack, showing what is chosen in its atlas, and taking voxels away.

Notation: bs = block_size, B = bs + 2. Macroblocks in use are numbered 0 ... n - 1 in the grid's order. *Voxels* are those of
their data with any opacity. Two touch where they share a face, an edge or a corner; a *part* is all that hangs together by
touching. Positions are (x, y, z) in voxels of the grid, places (z, y, x) in macroblocks; a mask is bool [bs, bs, bs], a
macroblock's data as it lies in the atlas.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from math import inf, prod
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from console import UserError
from scenepack.blocks import COPIED, PADDING, STEPS, along, block_copy, block_data, with_macroblocks
from scenepack.exports.field import Corners, ExportFrame
from scenepack.files import ZIP_ERRORS
from scenepack.pack import Pack

TOUCHING = np.ones((3, 3, 3), bool)
Test = Callable[[np.ndarray], np.ndarray]  # positions, float64 [m, 3] -> bool [m]


@dataclass(frozen=True, eq=False)
class Selection:
    """A set of voxels. bits: packed masks (np.packbits) of the macroblocks that hold some of them, by number; none is empty.

    Arrays are never changed, and shared between selections: where two agree, they mostly hold the same object.
    """

    bits: Mapping[int, np.ndarray] = field(default_factory=dict)

    def __or__(self, other: Selection) -> Selection:
        added = {k: self.bits[k] | bits if k in self.bits else bits for k, bits in other.bits.items()}
        return Selection({**self.bits, **added})

    def __sub__(self, other: Selection) -> Selection:
        left = ((k, bits & ~other.bits[k] if k in other.bits else bits) for k, bits in self.bits.items())
        return Selection({k: bits for k, bits in left if bits.any()})

    @cached_property
    def count(self) -> int:
        return sum(int(np.bitwise_count(bits).sum()) for bits in self.bits.values())

    def save(self, file: Path) -> None:
        """Writes it as an .npz, for `load`. OSError where that fails."""
        numbers, bits = list(self.bits), list(self.bits.values())
        np.savez_compressed(file, numbers=np.array(numbers, np.int64), bits=np.array(bits, np.uint8))

    @classmethod
    def load(cls, file: Path, pack: Pack) -> Selection:
        """The selection in a file that `save` wrote of voxels of `pack`. UserError where it is not that."""
        try:
            with np.load(file, allow_pickle=False) as arrays:
                numbers, bits = arrays["numbers"], arrays["bits"]
            if bits.dtype != np.uint8 or bits.shape != (len(numbers), -(-(pack.block_size**3) // 8)):
                raise ValueError("the voxels are of another block size")
            if len(numbers) and not 0 <= numbers.min() <= numbers.max() < pack.occupied.sum():
                raise ValueError("the voxels are of another pack")
        except (OSError, ValueError, KeyError, EOFError, *ZIP_ERRORS) as error:
            raise UserError("is not a selection of this pack's voxels", where=file, found=error) from error
        return cls({int(k): each for k, each in zip(numbers, bits, strict=True) if each.any()})


NOTHING = Selection()


class Voxels:
    """The voxels of a pack: which there are, and ways to choose among them. Reads the atlas anew each time."""

    def __init__(self, pack: Pack) -> None:
        self.pack, self.frame = pack, ExportFrame(pack)
        self.places = np.argwhere(pack.occupied)
        numbers = np.full([n + 2 for n in pack.occupied.shape], -1)
        numbers[1:-1, 1:-1, 1:-1][pack.occupied] = np.arange(len(self.places))
        near = self.places[:, None] + np.array(STEPS) + 1
        # int [n, 26]; -1: not in use, or outside of the grid
        self.neighbours = numbers[tuple(np.moveaxis(near, -1, 0))]

    def content(self, number: int) -> np.ndarray:
        """Mask of a macroblock's voxels, bool [bs, bs, bs]."""
        return np.asarray(self._alpha(number) > 0)

    def _alpha(self, number: int) -> np.ndarray:
        return block_data(self.pack, self.pack.atlas_rgba, tuple(self.places[number]))[..., 3]

    @cached_property
    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of boxes of the grid frame that hold the centres of each macroblock's voxels: float64 [n, 3] both."""
        pack, farthest = self.pack, 2.0 * (self.pack.contraction or inf)  # there is nothing beyond
        ends = ((end - pack.min_xyz) / pack.voxel_size for end in (-farthest, farthest))
        low, high = (np.clip(end, 0.0, pack.grid_size) for end in ends)
        first = self.places[:, ::-1] * float(pack.block_size) + 0.5
        first, last = (np.clip(corner, low + 0.5, high - 0.5) for corner in (first, first + pack.block_size - 1))
        shares = 0.5 * np.array(list(product((0, 1, 2), repeat=3)))  # ends, and middles where space is bent
        positions = first[:, None] + shares * (last - first)[:, None]
        points = self.frame.points(positions.reshape(-1, 3)).reshape(len(first), -1, 3)
        return points.min(axis=1) - pack.voxel_size, points.max(axis=1) + pack.voxel_size  # which covers rounding

    def where(self, test: Test, near: np.ndarray | None) -> Selection:
        """Voxels of which `test` is true. near: bool [n], the macroblocks that are looked at; None: all."""

        def mask_of(number: int) -> np.ndarray:
            mask = self.content(number)
            z, y, x = np.nonzero(mask)
            corner = self.places[number, ::-1] * self.pack.block_size + 0.5
            mask[z, y, x] = test(np.stack([x, y, z], axis=1) + corner) if len(x) else False
            return mask

        with np.errstate(all="ignore"):  # what lies next to infinity
            return self._chosen(mask_of, None if near is None else np.flatnonzero(near).tolist())

    def _chosen(self, mask_of: Callable[[int], np.ndarray], numbers: Iterable[int] | None = None) -> Selection:
        """The voxels in the masks of macroblocks, by default of all."""
        masks = ((k, mask_of(k)) for k in (range(len(self.places)) if numbers is None else numbers))
        return Selection({number: np.packbits(mask) for number, mask in masks if mask.any()})

    def mask(self, selection: Selection, number: int) -> np.ndarray:
        """Of a macroblock, which voxels are selected: bool [bs, bs, bs]."""
        shape, bits = (self.pack.block_size,) * 3, selection.bits.get(number)
        if bits is None:
            return np.zeros(shape, bool)
        return np.unpackbits(bits, count=prod(shape)).reshape(shape).view(bool)

    def everything(self) -> Selection:
        return self._chosen(self.content)

    def fainter_than(self, alpha: float) -> Selection:
        """Voxels whose opacity (0 ... 1) is below `alpha`."""
        return self._chosen(lambda number: self.content(number) & (self._alpha(number) < 255.0 * alpha))

    def in_box(self, corners: Corners) -> Selection:
        """Voxels whose centres lie in a box of the grid frame, given by two corners."""
        low, high = np.sort(np.asarray(corners, np.float64), axis=0)

        def test(positions: np.ndarray) -> np.ndarray:
            points = self.frame.points(positions)
            return np.all((points >= low) & (points <= high), axis=1)

        return self.where(test, np.all((self.boxes[1] >= low) & (self.boxes[0] <= high), axis=1))

    def in_sphere(self, centre: np.ndarray, radius: float) -> Selection:
        """Voxels whose centres lie in a ball of the grid frame. centre: float [3]."""
        points, near = self.frame.points, np.linalg.norm(np.clip(centre, *self.boxes) - centre, axis=1) <= radius
        return self.where(lambda at: np.square(points(at) - centre).sum(axis=1) <= radius**2, near)

    def in_ball(self, centre: np.ndarray, radius: float) -> Selection:
        """Voxels whose centres lie within `radius` of a position, both in voxels: in bent space this is no sphere."""
        first, size = self.places[:, ::-1] * self.pack.block_size, self.pack.block_size
        near = np.all((first <= centre + radius) & (first + size >= centre - radius), axis=1)
        return self.where(lambda positions: np.square(positions - centre).sum(axis=1) <= radius**2, near)

    def grown(self, selection: Selection) -> Selection:
        """With all voxels that touch one of it."""
        held = np.array(sorted(selection.bits), np.intp)
        reached = {*held.tolist(), *self.neighbours[held].ravel().tolist()} - {-1}

        def mask_of(number: int) -> np.ndarray:
            around = np.zeros((self.pack.padded_block_size,) * 3, bool)
            around[1:-1, 1:-1, 1:-1] = self.mask(selection, number)
            for step, other in zip(STEPS, self.neighbours[number].tolist(), strict=True):
                if other in selection.bits:
                    around[along(PADDING, step)] = self.mask(selection, other)[along(COPIED, step)]
            for axis in range(3):
                line = np.moveaxis(around, axis, 0)
                around = np.moveaxis(line[:-2] | line[1:-1] | line[2:], 0, axis)
            return around & self.content(number)

        return selection | self._chosen(mask_of, sorted(reached))

    def shrunk(self, selection: Selection) -> Selection:
        """Without those that touch a voxel outside of it."""
        return selection - self.grown(self.everything() - selection)

    def parts(self) -> Parts:
        """How all voxels hang together.

        Labels each padded copy by itself, then joins labels of voxels that two copies hold: pairs that touch lie in one copy.
        """
        pack, side, count = self.pack, self.pack.padded_block_size, len(self.places)
        labels = np.zeros((count, side, side, side), np.uint16)  # at most (B / 2)^3 of them
        found = np.zeros(count + 1, np.int64)
        for number, place in enumerate(self.places):
            opaque = block_copy(pack, pack.atlas_rgba, tuple(place))[..., 3] > 0
            found[number + 1] = ndimage.label(opaque, TOUCHING, output=labels[number])
        first = np.cumsum(found)  # of all labels, those of a macroblock begin there
        pairs = [_joined(self, labels, first, i) for i in range(len(STEPS) // 2, len(STEPS))]  # the others say the same
        one, other = np.concatenate(pairs, axis=1)
        joined = coo_matrix((np.ones(len(one), bool), (one, other)), shape=(first[-1], first[-1]))
        _, part = connected_components(joined, directed=False)
        data = labels[:, 1:-1, 1:-1, 1:-1].reshape(count, -1)
        held = [np.bincount(row, minlength=found[k + 1] + 1)[1:] for k, row in enumerate(data)]
        size_of = np.bincount(part, np.concatenate([*held, []])).astype(np.int64)
        largest, small = int(size_of.argmax()) if len(size_of) else 0, {}
        for number, row in enumerate(data):
            of_label = np.concatenate([[largest], part[first[number] : first[number + 1]]])
            some = np.flatnonzero((of_label != largest)[row])
            if len(some):
                small[number] = some, size_of[of_label[row[some]]]
        return Parts(small, pack.block_size)


@dataclass(frozen=True)
class Parts:
    """All parts but the largest. voxels: by macroblock, which of its voxels and how many the part of each has, int [m] both."""

    voxels: Mapping[int, tuple[np.ndarray, np.ndarray]]
    block_size: int

    def smaller_than(self, count: float = inf) -> Selection:
        """The voxels of parts with fewer than `count` voxels; never those of the largest part."""
        bits = {}
        for number, (voxels, sizes) in self.voxels.items():
            mask = np.zeros(self.block_size**3, bool)
            mask[voxels[sizes < count]] = True
            if mask.any():
                bits[number] = np.packbits(mask)
        return Selection(bits)


def _joined(voxels: Voxels, labels: np.ndarray, first: np.ndarray, direction: int) -> np.ndarray:
    """int [2, m]: pairs of labels that name one voxel, in a macroblock's padding and in its neighbour's data."""
    near, step = voxels.neighbours[:, direction], STEPS[direction]
    own = np.flatnonzero(near >= 0)
    outer = labels[:, *along(PADDING, step)][own].astype(np.int64)
    inner = labels[:, 1:-1, 1:-1, 1:-1][:, *along(COPIED, step)][near[own]].astype(np.int64)
    both = (outer > 0) & (inner > 0)
    outer += first[own].reshape(-1, 1, 1, 1) - 1
    inner += first[near[own]].reshape(-1, 1, 1, 1) - 1
    keys = np.unique(outer[both] * first[-1] + inner[both])
    return np.stack(np.divmod(keys, max(int(first[-1]), 1)))


# --- A pack without some of its voxels ---


def without(pack: Pack, removed: Selection, how: Sequence[str]) -> Pack:
    """A pack without these voxels, and without macroblocks that hold nothing. how: what the provenance says of the removal.

    UserError where nothing would be left.
    """
    voxels = Voxels(pack)
    numbers = [k for k in range(len(voxels.places)) if (voxels.content(k) & ~voxels.mask(removed, k)).any()]
    if not numbers:
        raise UserError("nothing would be left", remedy="remove less")
    kept = np.zeros_like(pack.occupied)
    kept[tuple(voxels.places[numbers].T)] = True

    def left(number: int) -> tuple[tuple[int, ...], np.ndarray]:
        place = tuple(voxels.places[number])
        data = np.concatenate([block_data(pack, atlas, place) for atlas in pack.atlases], axis=-1)
        data[voxels.mask(removed, number)] = 0
        return place, data

    before = pack.metadata.get("provenance")
    provenance: dict[str, Any] = dict(before) if isinstance(before, Mapping) else {}
    earlier = provenance.get("edits")
    dropped = len(voxels.places) - len(numbers)
    edit = {"how": list(how), "voxels_removed": removed.count, "macroblocks_removed": dropped}
    provenance["edits"] = [*(earlier if isinstance(earlier, list) else []), edit]
    return with_macroblocks(pack, map(left, numbers), kept).with_metadata(provenance=provenance)


# --- Removed and selected voxels, shown in the atlas of a pack that is open ---

MARKED = np.array([255, 20, 90], np.float32)  # a warning colour, sRGB

State = tuple[Selection, Selection]  # removed, selected
Values = tuple[tuple[np.ndarray, ...], list[np.ndarray]]  # z, y and x, int [m] each, and of each atlas uint8 [m, 4]


@dataclass
class EditPreview:
    """Shows edits in the atlas, macroblock by macroblock, and takes them back. Call follow() often; take() returns those
    that must be uploaded again. What is removed becomes empty, what is selected MARKED with its opacity as it was."""

    voxels: Voxels
    _goal: State = (NOTHING, NOTHING)
    _todo: list[int] = field(default_factory=list)  # macroblocks that show something else than the goal
    _changed: set[int] = field(default_factory=set)  # not taken yet, padding included
    _shown: dict[int, tuple[np.ndarray | None, ...]] = field(default_factory=dict)  # bits removed and selected
    _originals: dict[int, Values] = field(default_factory=dict)

    @property
    def settled(self) -> bool:
        """Whether the atlas shows the last edits, and take() has returned all that changed."""
        return not self._todo and not self._changed

    def differs(self, removed: Selection, selected: Selection) -> bool:
        """Whether these are not the edits that follow() was given last."""
        return self._goal != (removed, selected)

    def follow(self, removed: Selection, selected: Selection, seconds: float = inf) -> None:
        """Applies these edits to the atlas. Stops after about `seconds`; the next call continues."""
        end = time.perf_counter() + seconds
        if self.differs(removed, selected):
            self._goal = removed, selected
            wanted = {*self._shown, *removed.bits, *selected.bits}
            now = {k: self._shown.get(k, (None, None)) for k in sorted(wanted)}
            self._todo = [k for k in now if any(a is not b for a, b in zip(self._bits(k), now[k], strict=True))]
        while self._todo and time.perf_counter() < end:
            self._show(self._todo.pop())

    def take(self, most: int) -> list[int]:
        """Some of the macroblocks, by number, whose padded copies have changed; none before the atlas shows everything."""
        if self._todo:  # their neighbours may change again
            return []
        return [self._changed.pop() for _ in range(min(most, len(self._changed)))]

    def _bits(self, number: int) -> tuple[np.ndarray | None, ...]:
        return tuple(selection.bits.get(number) for selection in self._goal)

    def _show(self, number: int) -> None:
        pack = self.voxels.pack
        place = tuple(self.voxels.places[number])
        data = [block_data(pack, atlas, place) for atlas in pack.atlases]
        removed, selected = (self.voxels.mask(selection, number) for selection in self._goal)
        touched = at = np.nonzero(removed | selected)
        if number in self._originals:
            before, originals = self._originals.pop(number)
            touched = tuple(np.concatenate(both) for both in zip(at, before, strict=True))
            for values, original in zip(data, originals, strict=True):
                values[before] = original
        if len(at[0]):
            self._originals[number] = at, [values[at] for values in data]
            alpha = data[0][at][:, 3:] * selected[at][:, None]
            for values in data:
                values[at] = 0
            data[0][at] = np.concatenate([np.rint(alpha * (MARKED / 255.0)).astype(np.uint8), alpha], axis=1)
        self._shown[number] = self._bits(number)
        self._changed.add(number)
        reaches = [{-1: axis.min() == 0, 0: True, 1: axis.max() == pack.block_size - 1} for axis in touched]
        for step, neighbour in zip(STEPS, self.voxels.neighbours[number].tolist(), strict=True):
            border = along(COPIED, [-s for s in step])  # what the neighbour's padding copies
            if neighbour < 0 or not all(ends[s] for ends, s in zip(reaches, step, strict=True)):
                continue
            self._changed.add(neighbour)
            for atlas, values in zip(pack.atlases, data, strict=True):
                copy = block_copy(pack, atlas, tuple(self.voxels.places[neighbour]))
                copy[along(PADDING, [-s for s in step])] = values[border]
