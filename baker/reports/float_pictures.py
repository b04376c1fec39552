"""Pictures of a bake that is not quantised, as the viewer would draw it if its textures held floats."""

# pyright: reportCallIssue=false

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numba import njit

from baker.baking.grid import FloatGrid
from baker.reports.evaluation import Drawn, Mode, picture_of
from baker.tuning.marcher import LISTED, MAX_ALPHA, PackMarcher, list_samples, pack_rays
from baker.tuning.shading import shown
from scenepack.constants import ALPHA_CONTRIBUTES, TRANSMITTANCE_STOP
from training.method import Rays
from training.run import Run
from training.scenes import Camera


def float_pictures(floats: FloatGrid, run: Run) -> Drawn:
    """What draws a grid of floats with the run's own view MLP."""
    no_rays: Any = None  # those of a view take their place
    head, dataset, marcher = run.method.view_mlp(run.state), run.dataset, PackMarcher(floats.pack, no_rays)
    march = partial(accumulate_floats, floats.rows.ravel(), floats.values)

    def show(camera: Camera, mode: Mode) -> np.ndarray:
        rays = dataset.view_rays(camera)
        view: Any = ViewRays(rays)
        marcher.rays = pack_rays(floats.pack, view)
        parts = np.zeros((rays.origins.shape[0], 8), np.float32)
        marcher.over(np.arange(len(parts), dtype=np.int32), march, lambda _, first: parts[first:])
        output = shown(jnp.asarray(parts), head, rays.viewdirs, dataset.background, dataset.ndc)
        return picture_of(output, camera, mode)

    return Drawn(show, floats.pack.grid_size, bytes=floats.bytes)


class ViewRays(NamedTuple):
    """Rays of a view, in place of a dataset's."""

    rays: Rays

    def geometry_at(self, ids: jax.Array, away: jax.Array | None = None) -> Rays:
        return Rays(*(array[ids] for array in self.rays))


@njit(nogil=True, cache=True)
def accumulate_floats(rows, values, tables, rays, low, high, found, sums):
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
