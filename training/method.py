"""Interface of trainable models: the paper's MLPs and the multi-resolution field. The loop, the baker and `snerg-eval` use it
alone.

Shapes: N rays or points. Directions are unit length unless NDC; viewdirs are unit, in the training frame, before any NDC warp.
"""

from typing import Any, NamedTuple, Protocol

import jax
import numpy as np


class Rays(NamedTuple):
    origins: jax.Array  # [N, 3]
    directions: jax.Array  # [N, 3]: point(t) = origin + t direction
    viewdirs: jax.Array  # [N, 3]
    near: jax.Array  # [N]: bounds of t
    far: jax.Array


class FieldOutput(NamedTuple):
    density: jax.Array  # [N] per unit of world length, >= 0
    diffuse: jax.Array  # [N, 3] in [0, 1]
    features: jax.Array  # [N, 4] in [0, 1]


class RenderOutput(NamedTuple):
    rgb: jax.Array  # [N, 3], the final colour
    alpha: jax.Array  # [N]


class ViewMlpParams(NamedTuple):
    """The view MLP (paper section 4.2)."""

    weights: tuple[jax.Array, jax.Array, jax.Array]  # [34, 16], [16, 16], [16, 3]
    biases: tuple[jax.Array, jax.Array, jax.Array]  # [16], [16], [3]


class Method(Protocol):
    """A trainable deferred radiance field. `state` is a pytree; nothing else changes between steps."""

    def start(self, key: jax.Array) -> Any:
        """The state before step 0."""
        ...

    def step(self, state: Any, step: int, progress: float | None = None) -> tuple[Any, dict[str, jax.Array]]:
        """The new state, and scalar metrics with at least "loss" and "psnr" of the batch. Randomness comes from seed and `step`
        alone.

        progress in [0, 1]: how far down the learning rates are; None: the share of the config's steps that are done.
        """
        ...

    def render(self, state: Any, rays: Rays) -> RenderOutput:
        """Renders rays (any N; batches inside), without randomness."""
        ...

    def query(self, state: Any, points: jax.Array) -> FieldOutput:
        """The field at points [N, 3] of the training frame (NDC space for forward-facing scenes)."""
        ...

    def may_hold(self, state: Any, low: np.ndarray, high: np.ndarray) -> np.ndarray | None:
        """bool [N]: which boxes of the training frame, from low to high [N, 3], may hold density; None: ask `query`."""
        return None

    def grain(self, state: Any) -> np.ndarray | None:
        """float64 [3]: sides of the field's voxels, within which it is smooth, in the training frame; None where it has none."""
        return None

    def view_mlp(self, state: Any) -> ViewMlpParams | None:
        """The deferred head; None for a diffuse model."""
        ...

    def gains(self, state: Any) -> np.ndarray | None:
        """float32 [V, 3]: of each training photograph (training.exposure); None where photographs are taken as they are."""
        return None

    def save(self, state: Any) -> dict[str, np.ndarray]:
        """Everything `restore` needs to go on, as named arrays."""
        ...

    def restore(self, arrays: dict[str, np.ndarray]) -> Any:
        """The inverse of save."""
        ...
