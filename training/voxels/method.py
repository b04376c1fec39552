"""The fast method: a sparse voxel grid optimised directly, coarse to fine, behind the same deferred head as the paper's.

    state      what is trained, in plain arrays        settings   what a config means for a dataset
    field      raw values -> density, colours, rays    engine     the seam: state in, state out
    step       one step (JAX); fused: on processors    refine     what happens to voxels between steps
    render     whole pictures                          holes      walls where no photograph looks
    saving     checkpoints

Here they are joined into a training.method.Method.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from training import exposure
from training.config import TrainConfig
from training.dataset import RayDataset
from training.devices import agree, here
from training.method import FieldOutput, Rays, RenderOutput, ViewMlpParams
from training.view_mlp import init_view_mlp
from training.voxels.checked import require_fitting
from training.voxels.engines import make_engine
from training.voxels.holes import close_holes
from training.voxels.refine import dense_start, refine
from training.voxels.saving import restore
from training.voxels.settings import plan_of, settings_of
from training.voxels.sparse_grid import boxes_with_voxels
from training.voxels.state import VoxelState

REMEMBER_EVERY = 50  # steps between looks at how deep, optically, cells are
HEAD_BIAS = -3.0  # the view MLP starts near zero, so that diffuse colour settles first


class VoxelMethod:
    """The fast field behind training.method.Method."""

    def __init__(self, config: TrainConfig, dataset: RayDataset) -> None:
        self.config, self.dataset = config, dataset
        self.plan = plan_of(config, dataset)
        self.settings = settings_of(config, dataset, self.plan)
        self.engine = make_engine(config.engine, dataset, self.plan, self.settings, config.seed)

    def start(self, key: jax.Array) -> Any:
        head = None
        if self.config.voxels.view_dependence:
            head = init_view_mlp(key)
            head = head._replace(biases=(*head.biases[:2], head.biases[2] + HEAD_BIAS))
        step_voxels = self.config.voxels.step_voxels
        return self.engine.begin(self._with_gains(dense_start(self.plan, self.dataset.local(), head, step_voxels)))

    def step(self, state: Any, step: int, progress: float | None = None) -> tuple[Any, dict[str, Any]]:
        if progress is None:
            progress = step / max(self.config.steps, 1)
        voxels, resolution = self.config.voxels, self.plan.schedule.get(step)
        if resolution is not None and step > 0:
            state = refine(self.engine, state, resolution, self.plan)
        finer = progress >= voxels.finer_samples_from and state.step_voxels > voxels.last_step_voxels
        if finer:
            state = self.engine.sample_finer(state, voxels.last_step_voxels)
        closing = not state.closed and progress >= voxels.close_holes_from < 1
        if closing:
            state = close_holes(self.engine, state, self.dataset.local(), self.plan, self.settings)
        if finer or closing or step % REMEMBER_EVERY == 0 or resolution is not None:
            state = self.engine.remember(state)  # at a new stage, too: compiled then, not later
        if self.plan.gains and exposure.due(step):
            state = self.engine.with_gains(state, self._fitted_gains(state, step))
        return self.engine.step(state, step, progress)

    def render(self, state: Any, rays: Rays) -> RenderOutput:
        return self.engine.render(state, rays)

    def query(self, state: Any, points: jax.Array) -> FieldOutput:
        return self.engine.query(state, points)

    def may_hold(self, state: Any, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Whether the boxes meet any present voxel's support; see training.method.Method."""
        return boxes_with_voxels(self.engine.occupancy(state), low, high)

    def grain(self, state: Any) -> np.ndarray:
        """The sides of the voxels; see training.method.Method."""
        return self.engine.occupancy(state).voxel

    def view_mlp(self, state: Any) -> ViewMlpParams | None:
        return self.engine.view_mlp(state)

    def gains(self, state: Any) -> np.ndarray | None:
        return self.engine.gains(state)

    def save(self, state: Any) -> dict[str, np.ndarray]:
        return self.engine.arrays(state)

    def restore(self, arrays: Mapping[str, np.ndarray]) -> Any:
        photographs = self.dataset.views if self.plan.gains else None
        require_fitting(
            arrays, self.dataset.count, with_head=self.config.voxels.view_dependence, photographs=photographs
        )
        return self.engine.begin(self._with_gains(restore(arrays)))

    def _with_gains(self, state: VoxelState) -> VoxelState:
        """The state with gains to fit, where they are fitted and there are none yet."""
        if not self.plan.gains or state.gains is not None:
            return state
        return state._replace(gains=np.ones((self.dataset.views, 3), np.float32))

    def _fitted_gains(self, state: Any, step: int) -> np.ndarray:
        """The photographs' gains [V, 3] by what the field shows of some of their rays now; the same in every process."""
        gains, dataset = self.engine.gains(state), self.dataset
        assert gains is not None
        drawn = exposure.drawn(np.asarray(here(dataset.first)), dataset.count, (self.config.seed, step))
        ids = drawn.ravel().astype(np.int32)
        shown = self.engine.render(state, dataset.local().geometry_at(jnp.asarray(ids)))
        opacity = np.asarray(shown.alpha)[:, None]
        look = np.asarray(shown.rgb) - (1.0 - opacity) * np.asarray(dataset.background, np.float32)
        pixels = dataset.pixels_here(ids)
        found = exposure.fitted(
            gains, look.reshape(*drawn.shape, 3), opacity.reshape(drawn.shape), pixels.reshape(*drawn.shape, -1),
            auto=self.config.exposure == "auto",
        )  # fmt: skip
        return np.asarray(agree(found))
