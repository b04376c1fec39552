"""Pictures of a bake that is not quantised, as the viewer would draw it if its textures held floats."""

from __future__ import annotations

import importlib.util
from typing import Literal

import jax.numpy as jnp
import numpy as np

from baker.baking.float_grid import FloatGrid
from baker.reports.evaluation import Drawn
from baker.tuning.marcher import Accumulated, Box
from baker.tuning.pack_layout import over_background
from console import UserError
from scenepack.constants import TRANSMITTANCE_SHADED
from training.run import Run
from training.scenes import Camera
from training.view_mlp import apply_view_mlp


def require_compiled_loops() -> None:
    """UserError where Numba is missing, which marches grids of floats."""
    if importlib.util.find_spec("numba") is None:
        raise UserError("a bake in floats is marched by compiled loops", remedy="pip install numba, or 'snerg[train]'")


def float_pictures(floats: FloatGrid, run: Run) -> Drawn:
    """What draws a grid of floats with the run's own view MLP. UserError where Numba is missing."""
    require_compiled_loops()
    from baker.tuning.fused.float_marcher import FloatMarcher

    grid, head, dataset = floats.grid, run.method.view_mlp(run.state), run.dataset
    box = Box(jnp.asarray(grid.min_xyz, jnp.float32), jnp.float32(grid.voxel_size), jnp.asarray(grid.size, jnp.int32))
    grid_T_training = jnp.asarray(np.linalg.inv(grid.worldspace_T_opengl), jnp.float32)
    marcher = FloatMarcher(floats.indices, floats.rows, floats.values, grid.block_size, box, grid_T_training)

    def show(camera: Camera, mode: Literal["normal", "alpha"]) -> np.ndarray:
        rays = dataset.view_rays(camera)
        sums = Accumulated(*(jnp.asarray(part) for part in marcher.accumulate(rays)))
        diffuse, features, behind = over_background(sums, dataset.background, dataset.ndc)
        if mode == "alpha":
            return np.asarray(1 - behind).reshape(camera.height, camera.width)
        if head is not None:
            residual = apply_view_mlp(head, diffuse, features, rays.viewdirs)
            diffuse = diffuse + jnp.where((behind <= TRANSMITTANCE_SHADED)[:, None], residual, 0.0)
        return np.clip(np.asarray(diffuse), 0, 1).reshape(camera.height, camera.width, 3)

    return Drawn(show, grid.size)
