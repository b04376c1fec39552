"""The seam between the fast method and what computes its steps, so that one field can be trained by several programs.

Between steps everything is shared: the dense start, pruning, refining, whole pictures, checkpoints. These work on a
VoxelState, plain arrays; an engine keeps what it makes of one in a form of its own, from `begin` to `end`. What they ask of
many rays or voxels, the engine answers.
"""

from __future__ import annotations

from typing import Any, Protocol

import jax
import numpy as np

from training.method import FieldOutput, Rays, RenderOutput
from training.voxels.sparse_grid import GridLayout
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

    def step(self, state: Any, step: int, progress: float) -> tuple[Any, dict[str, Any]]:
        """One update of the trainable values and their moments, and its metrics (see training.method.Method.step).

        progress in [0, 1]: how far down the learning rates are.
        """
        ...

    def remember(self, state: Any) -> Any:
        """The state whose layout knows the cells' optical depths as they are now, by which marches terminate early."""
        ...

    def meeting(self, layout: GridLayout, ids: np.ndarray) -> np.ndarray:
        """bool [N]: which of the training rays int [N] may have samples with support in a layout; False only without any."""
        ...

    def visible_weights(self, state: Any, ids: np.ndarray) -> np.ndarray:
        """float32 [V + 1], by row of the layout: the largest weight of a sample in each voxel, over training rays int [N]."""
        ...

    def raw_at(self, state: Any, points: np.ndarray) -> np.ndarray:
        """Raw values float32 [N, 8] of a state at world points float32 [N, 3]."""
        ...

    def query(self, state: Any, points: jax.Array) -> FieldOutput:
        """The field at world points float32 [N, 3]; see training.method.Method.query."""
        ...

    def render(self, state: Any, rays: Rays) -> RenderOutput:
        """Every ray to its last sample, these taken as the viewer takes them; see training.method.Method.render."""
        ...
