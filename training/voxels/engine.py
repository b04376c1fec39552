"""The seam between the fast method and what computes its steps, so that one field can be trained by several programs.

Between steps everything is shared: the dense start, pruning, refining, whole pictures, checkpoints. An engine is handed the
dataset and the settings once, and from then on a state in, a state out. A state holds nothing of its engine's own.
"""

from __future__ import annotations

from typing import Protocol

import jax

from training.voxels.state import VoxelState


class Engine(Protocol):
    """What makes the steps: training.voxels.step.JaxEngine, or another that agrees with it to rounding.

    Agreement is defined by two pure functions of training.voxels.step: `draw`, all randomness of a step as one Batch of
    arrays, and `loss_and_gradient` of a Batch.
    """

    def step(self, state: VoxelState, step: int, progress: float) -> tuple[VoxelState, dict[str, jax.Array]]:
        """One update of the trainable values and their moments, and its metrics (see training.method.Method.step).

        What is random comes from the seed and `step` alone. progress in [0, 1]: how far down the learning rates are. The
        arrays of `state.optimised` may be used up.
        """
        ...

    def remember(self, state: VoxelState) -> VoxelState:
        """The state whose layout knows the cells' optical depths as they are now, by which marches terminate early."""
        ...
