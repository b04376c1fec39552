"""Shows removed and selected voxels in the atlas of a pack that is open, macroblock by macroblock, and takes that back.

What is removed becomes empty, what is selected MARKED with its opacity as it was; so whatever reads the atlas sees the same.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from math import inf

import numpy as np

from scenepack.blocks import block_copy
from scenepack.editing import COPIED, NOTHING, PADDING, STEPS, Selection, Voxels

MARKED = np.array([255, 20, 90], np.float32)  # a warning colour, sRGB

State = tuple[Selection, Selection]  # removed, selected
Values = tuple[np.ndarray, list[np.ndarray]]  # a mask, and what was there of each atlas, uint8 [m, 4]


@dataclass
class EditPreview:
    """Call follow() often; take() returns the macroblocks that must be uploaded again."""

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
            self._todo = [
                k for k in sorted(wanted) if any(a is not b for a, b in zip(self._bits(k), self._now(k), strict=True))
            ]
        while self._todo and time.perf_counter() < end:
            self._show(self._todo.pop())

    def take(self, most: int) -> list[int]:
        """Some of the macroblocks, by number, whose padded copies have changed; none before the atlas shows everything."""
        if self._todo:  # their neighbours may change again
            return []
        return [self._changed.pop() for _ in range(min(most, len(self._changed)))]

    @property
    def _atlases(self) -> list[np.ndarray]:
        pack = self.voxels.pack
        return [pack.atlas_rgba] if pack.atlas_features is None else [pack.atlas_rgba, pack.atlas_features]

    def _bits(self, number: int) -> tuple[np.ndarray | None, ...]:
        return tuple(selection.bits.get(number) for selection in self._goal)

    def _now(self, number: int) -> tuple[np.ndarray | None, ...]:
        return self._shown.get(number, (None, None))

    def _show(self, number: int) -> None:
        pack = self.voxels.pack
        place = tuple(self.voxels.places[number])
        data = [block_copy(pack, atlas, place)[1:-1, 1:-1, 1:-1] for atlas in self._atlases]
        removed, selected = (self.voxels.mask(selection, number) for selection in self._goal)
        mask = removed | selected
        touched = mask
        if number in self._originals:
            before, originals = self._originals.pop(number)
            touched = mask | before
            for values, original in zip(data, originals, strict=True):
                values[before] = original
        if mask.any():
            self._originals[number] = mask, [values[mask] for values in data]
            alpha = data[0][selected][:, 3:]
            for values in data:
                values[mask] = 0
            data[0][selected] = np.concatenate([np.rint(alpha * (MARKED / 255.0)).astype(np.uint8), alpha], axis=1)
        self._shown[number] = self._bits(number)
        self._changed.add(number)
        for step, neighbour in zip(STEPS, self.voxels.neighbours[number].tolist(), strict=True):
            border = tuple(COPIED[-s] for s in step)  # what the neighbour's padding copies
            if neighbour < 0 or not touched[border].any():
                continue
            self._changed.add(neighbour)
            for atlas, values in zip(self._atlases, data, strict=True):
                copy = block_copy(pack, atlas, tuple(self.voxels.places[neighbour]))
                copy[tuple(PADDING[-s] for s in step)] = values[border]
