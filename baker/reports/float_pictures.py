"""Pictures of a bake that is not quantised, as the viewer would draw it if its textures held floats."""

# pyright: reportCallIssue=false

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from numba import njit

from baker.baking.float_grid import FloatGrid
from baker.reports.evaluation import Drawn
from baker.tuning.marcher import (
    LISTED,
    MAX_ALPHA,
    PART,
    TOGETHER,
    Tables,
    box_of,
    lines_of,
    list_samples,
    mark_support,
    room_for_samples,
)
from baker.tuning.shading import Accumulated, over_background, shown
from scenepack.constants import ALPHA_CONTRIBUTES, EMPTY_BLOCK, TRANSMITTANCE_STOP
from training.marching.layout import GridBox
from training.marching.rays import GridRays, in_grid_frame, to_grid
from training.method import Rays
from training.multires.fused.workers import Workers
from training.run import Run
from training.scenes import Camera


def float_pictures(floats: FloatGrid, run: Run) -> Drawn:
    """What draws a grid of floats with the run's own view MLP."""
    head, dataset, marcher = run.method.view_mlp(run.state), run.dataset, FloatMarcher(floats)

    def show(camera: Camera, mode: Literal["normal", "alpha"]) -> np.ndarray:
        rays = dataset.view_rays(camera)
        sums = Accumulated(*(jnp.asarray(part) for part in marcher.accumulate(rays)))
        if mode == "alpha":
            behind = over_background(sums, dataset.background, dataset.ndc)[2]
            return np.asarray(1 - behind).reshape(camera.height, camera.width)
        rgb = shown(sums, head, rays.viewdirs, dataset.background, dataset.ndc)
        return np.clip(np.asarray(rgb), 0, 1).reshape(camera.height, camera.width, 3)

    return Drawn(show, floats.grid.size)


class FloatMarcher:
    """A grid of floats, marched as the viewer marches a pack (docs/rendering.md)."""

    def __init__(self, floats: FloatGrid) -> None:
        grid = floats.grid
        self.rows, self.values, self.workers = floats.rows.ravel(), floats.values, Workers()
        self.box = box_of(grid.min_xyz, grid.voxel_size, grid.size, grid.contraction)
        self.grid_T_training = jnp.asarray(np.linalg.inv(grid.worldspace_T_opengl), jnp.float32)
        self.tables = _tables(floats.indices, floats.rows, grid.block_size)
        self.found = [room_for_samples() for _ in range(self.workers.count)]

    def accumulate(self, rays: Rays) -> Accumulated:
        """What is accumulated along rays of the training frame, NumPy."""
        sums = np.zeros((rays.origins.shape[0], 8), np.float32)
        for first in range(0, len(sums), TOGETHER):
            some = np.minimum(np.arange(first, first + TOGETHER), len(sums) - 1)
            part = _in_grid(self.box, Rays(*(array[some] for array in rays)), self.grid_T_training)
            lines, last = lines_of(part), min(first + TOGETHER, len(sums))

            def share(worker: int, number: int, first: int = first, last: int = last, lines=lines) -> None:
                low, high = number * PART, min((number + 1) * PART, last - first)
                found = self.found[worker]
                accumulate_floats(self.tables, self.rows, self.values, lines, low, high, found, sums[first:last])

            self.workers.share(-(-(last - first) // PART), share)
        return Accumulated(sums[:, :3], sums[:, 3:7], sums[:, 7])  # type: ignore[arg-type]


@jax.jit
def _in_grid(box: GridBox, rays: Rays, grid_T_training: jax.Array) -> GridRays:
    """As training.marching.rays.GridFrameRays: from where they begin in training, without an end of their own."""
    moved = in_grid_frame(rays, grid_T_training)
    return to_grid(box, moved._replace(far=jnp.full_like(moved.far, jnp.inf)))


def _tables(indices: np.ndarray, rows: np.ndarray, block_size: int) -> Tables:
    """The tables of a grid of floats; without colours, which are looked up by rows."""
    _, height, width = rows.shape
    side, occupied = block_size + 2, indices[..., 0] != EMPTY_BLOCK
    slots = np.full(occupied.shape, -1, np.int32)
    slots[occupied] = np.arange(np.count_nonzero(occupied), dtype=np.int32)
    places = indices[occupied].astype(np.int64) * side
    first = (places[:, 2] * height + places[:, 1]) * width + places[:, 0]
    support = np.zeros((len(first), side**3), np.uint8)
    near = np.zeros((len(first), (-(-side // 4)) ** 3), np.uint8)
    marks = np.zeros((rows.size, 4), np.uint8)
    marks[:, 3] = rows.ravel() > 0
    mark_support(marks, first, width, width * height, side, support, near)
    blocks, nothing = np.array(occupied.shape[::-1], np.int64), np.zeros((0, 4), np.uint8)
    return Tables(slots.ravel(), blocks, block_size, first, width, width * height, support, near, nothing, nothing)


@njit(nogil=True, cache=True)
def accumulate_floats(tables, rows, values, rays, low, high, found, sums):
    """sums float32 [N, 8] of rays low … high - 1: premultiplied colour and features, and T behind all."""
    first, row, layer = tables.first, np.int64(tables.row), np.int64(tables.layer)
    one, blended, total = np.float32(1.0), np.empty(8, np.float32), np.empty(8, np.float32)
    for ray in range(low, high):
        passed, k, listed = one, np.int64(0), LISTED
        total[:] = np.float32(0.0)
        while listed == LISTED and passed > np.float32(TRANSMITTANCE_STOP):
            listed, k = list_samples(tables, rays, ray, k, LISTED, found)
            for i in range(listed):
                cell, at = found.cell[i], first[found.slot[i]]
                at += np.int64(cell[2]) * layer + np.int64(cell[1]) * row + np.int64(cell[0])
                fx, fy, fz = found.fraction[i, 0], found.fraction[i, 1], found.fraction[i, 2]
                blended[:] = np.float32(0.0)
                for corner in range(8):
                    stored = rows[at + (corner >> 2) * layer + (corner >> 1 & 1) * row + (corner & 1)]
                    if stored == 0:
                        continue
                    share = fz if corner >> 2 else one - fz
                    share *= fy if corner >> 1 & 1 else one - fy
                    share *= fx if corner & 1 else one - fx
                    for c in range(8):
                        blended[c] += share * values[stored, c]
                if blended[3] <= np.float32(ALPHA_CONTRIBUTES):
                    continue
                for c in range(3):
                    total[c] += passed * blended[c]
                for c in range(4):
                    total[3 + c] += passed * blended[4 + c]
                passed *= one - min(blended[3], np.float32(MAX_ALPHA))
                if passed <= np.float32(TRANSMITTANCE_STOP):
                    break
        for c in range(7):
            sums[ray, c] = total[c]
        sums[ray, 7] = passed
