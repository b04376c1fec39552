"""training.voxels.engine.Engine by XLA: for cards, for many devices and hosts, and the reference for other engines."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding

from training.dataset import RayDataset
from training.devices import WHOLE, here, put_whole
from training.method import FieldOutput, Rays, RenderOutput, ViewMlpParams
from training.voxels.field import query, remember_depths
from training.voxels.lists import fitting_sizes, rays_with_content
from training.voxels.render import render_all
from training.voxels.saving import save
from training.voxels.settings import Plan, Settings
from training.voxels.sparse_grid import CHANNELS, Occupancy, build_layout, occupancy_of, voxel_centres
from training.voxels.state import Trainable, VoxelState, state_over
from training.voxels.step import compiled_update
from training.voxels.survey import raw_at, visible_weights


class JaxEngine:
    """See training.voxels.engine.Engine. Samples are spread over the devices of the dataset's mesh.

    The ids of rays are padded to one length, and the lists of a step have a size that fits the stage, so that a stage compiles
    once.
    """

    def __init__(self, dataset: RayDataset, plan: Plan, settings: Settings, seed: int) -> None:
        self.dataset, self.plan, self.settings, self.key = dataset, plan, settings, jax.random.key(seed)
        self.geometry = dataset.local()  # what happens between steps needs no pixels, and each process does it alike

    def begin(self, state: VoxelState) -> VoxelState:
        if state.sizes is None:
            settings = self._settings(state)
            layout = remember_depths(state.trainable.rows, state.layout, settings)
            rays_to_draw = state.hits, int(state.hit_count)
            sizes, rays = fitting_sizes(self.geometry, layout, rays_to_draw, self.plan, settings)
            state = state._replace(layout=layout, sizes=sizes, rays=rays)
        if state.hits.shape[0]:
            missing = self.dataset.count - state.hits.shape[0]
            state = state._replace(hits=jnp.pad(state.hits, (0, missing)))
        return put_whole(state, self.dataset.mesh)

    def end(self, state: VoxelState) -> VoxelState:
        state = here(state)
        return state._replace(hits=state.hits[: int(state.hit_count)])

    def arrays(self, state: VoxelState) -> dict[str, np.ndarray]:
        return save(self.end(state))

    def step(self, state: VoxelState, step: int, progress: float) -> tuple[VoxelState, dict[str, jax.Array]]:
        dataset = self.dataset.in_average_look(state.gains)
        optimised, metrics = compiled_update(self.dataset.mesh)(
            state.optimised, state.stage, dataset, self.key, np.int32(step), np.float32(progress),
            sizes=state.sizes, rays=state.rays, settings=self._settings(state),
        )  # fmt: skip
        return state.after(optimised), metrics

    def gains(self, state: VoxelState) -> np.ndarray | None:
        return None if state.gains is None else np.asarray(here(state.gains))

    def with_gains(self, state: VoxelState, gains: np.ndarray) -> VoxelState:
        return state._replace(gains=put_whole(gains, self.dataset.mesh))

    def remember(self, state: VoxelState) -> VoxelState:
        remember = compiled_remembering(self.dataset.mesh)
        return state._replace(layout=remember(state.trainable.rows, state.layout, self._settings(state)))

    def sample_finer(self, state: VoxelState, step_voxels: float) -> VoxelState:
        return self.begin(self.end(state)._replace(step_voxels=step_voxels, sizes=None, rays=0))

    def occupancy(self, state: VoxelState) -> Occupancy:
        return occupancy_of(here(state.layout))

    def drawn(self, state: VoxelState) -> tuple[np.ndarray, int]:
        ended = self.end(state)
        return np.asarray(ended.hits), int(ended.hit_count)

    def meeting(self, state: VoxelState, ids: np.ndarray) -> np.ndarray:
        return rays_with_content(self.geometry, here(state.layout), ids, state.step_voxels)

    def visible_weights(self, state: VoxelState, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return visible_weights(self.end(state), self.geometry, ids, self._settings(state))

    def regrid(self, state: VoxelState, occupancy: Occupancy, kept: np.ndarray | None) -> VoxelState:
        before = self.end(state)
        old = before.trainable, before.first, before.second
        if kept is not None:
            values, first, second = (Trainable(part.rows[kept], part.head) for part in old)
        else:
            absent = np.zeros((1, CHANNELS), np.float32)
            rows = jnp.asarray(np.concatenate([absent, raw_at(before, voxel_centres(*occupancy))]))
            values = Trainable(rows, before.trainable.head)
            first, second = (Trainable(jnp.zeros_like(rows), part.head) for part in old[1:])
        layout, parts = build_layout(*occupancy), (values, first, second)
        return state_over(layout, parts, before.updates, self.dataset.count, before.step_voxels, before.gains)

    def draw_from(self, state: VoxelState, hits: np.ndarray, hit_count: int) -> VoxelState:
        ended = self.end(state)
        return self.begin(ended._replace(hits=jnp.asarray(hits), hit_count=jnp.int32(hit_count), sizes=None, rays=0))

    def view_mlp(self, state: VoxelState) -> ViewMlpParams | None:
        return self.end(state).trainable.head

    def query(self, state: VoxelState, points: jax.Array) -> FieldOutput:
        return query(state.trainable.rows, state.layout, points, self._settings(state))

    def render(self, state: VoxelState, rays: Rays) -> RenderOutput:
        return render_all(self.end(state), rays, self._settings(state))

    def _settings(self, state: VoxelState) -> Settings:
        return self.settings._replace(step_voxels=state.step_voxels)


@lru_cache
def compiled_remembering(mesh: Mesh) -> Callable[..., Any]:
    """`remember_depths`, jitted to return what the step's compilation expects: a layout whole on every device."""
    return jax.jit(remember_depths, static_argnums=2, out_shardings=NamedSharding(mesh, WHOLE))
