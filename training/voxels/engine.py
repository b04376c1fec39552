"""The seam between the fast method and what computes its steps, so that one field can be trained by several programs.

Between steps everything is shared: the dense start, what is pruned and when a grid grows finer, whole pictures, checkpoints.
A run begins with a VoxelState, plain arrays, and its checkpoints are such; an engine keeps what it makes of one in a form of its
own, from `begin` to `end`. What is asked of many rays or voxels, and the move to another grid, are the engine's.
"""

from __future__ import annotations

from typing import Any, Protocol

import jax
import numpy as np

from training.method import FieldOutput, Rays, RenderOutput, ViewMlpParams
from training.voxels.sparse_grid import Occupancy
from training.voxels.state import VoxelState


class Engine(Protocol):
    """What makes the steps: training.voxels.jax_engine.JaxEngine, or another that agrees with it to rounding.

    Agreement is defined by training.voxels.step.loss_and_gradient of a Batch. What is random about a step comes from the
    seed and the step alone; two engines may draw differently.
    """

    def begin(self, state: VoxelState) -> Any:
        """The engine's own form of a state, which `step` may change in place. Cheap: a state may never be stepped."""
        ...

    def end(self, state: Any) -> VoxelState:
        """The inverse of begin; the state stays as it is."""
        ...

    def arrays(self, state: Any) -> dict[str, np.ndarray]:
        """A state's checkpoint: what training.voxels.saving.restore takes."""
        ...

    def step(self, state: Any, step: int, progress: float) -> tuple[Any, dict[str, Any]]:
        """One update of the trainable values and their moments, and its metrics (see training.method.Method.step).

        progress in [0, 1]: how far down the learning rates are.
        """
        ...

    def gains(self, state: Any) -> np.ndarray | None:
        """The photographs' gains [V, 3] (training.exposure), on the host; None where they are taken as they are."""
        ...

    def with_gains(self, state: Any, gains: np.ndarray) -> Any:
        """The state whose steps divide photographs by other gains."""
        ...

    def remember(self, state: Any) -> Any:
        """The state whose layout knows the cells' optical depths as they are now, by which marches terminate early."""
        ...

    def sample_finer(self, state: Any, step_voxels: float) -> Any:
        """The state whose samples lie so many voxels apart from now on; to be remembered before its next step."""
        ...

    def occupancy(self, state: Any) -> Occupancy:
        """Where a state's voxels are. Rows of a state's values below are numbered as its present voxels are, from 1."""
        ...

    def drawn(self, state: Any) -> tuple[np.ndarray, int]:
        """The ids of the rays that steps draw from, int32, and how many these are; no ids where every ray is meant."""
        ...

    def meeting(self, state: Any, ids: np.ndarray) -> np.ndarray:
        """bool [N]: which of the training rays int [N] may have samples with support; False only without any."""
        ...

    def visible_weights(self, state: Any, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """float32 [V + 1] twice, by row: the largest weight of a sample in each voxel, over training rays int [N], and the sum
        of all."""
        ...

    def regrid(self, state: Any, occupancy: Occupancy, kept: np.ndarray | None) -> Any:
        """A state over other voxels, which takes the place of `state`: give it the rays that it draws from (draw_from) before
        any step.

        kept int [V' + 1]: the row that each voxel had, moments included; None where values are interpolated at the voxels'
        centres, and their moments begin anew.
        """
        ...

    def draw_from(self, state: Any, hits: np.ndarray, hit_count: int) -> Any:
        """The state whose steps draw from other rays, told as by `drawn`."""
        ...

    def view_mlp(self, state: Any) -> ViewMlpParams | None:
        """A state's view MLP; None for a diffuse model."""
        ...

    def query(self, state: Any, points: jax.Array) -> FieldOutput:
        """The field at world points float32 [N, 3]; see training.method.Method.query."""
        ...

    def render(self, state: Any, rays: Rays) -> RenderOutput:
        """Every ray to its last sample, these taken as the viewer takes them; see training.method.Method.render."""
        ...
