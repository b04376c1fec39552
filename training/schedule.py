"""The learning rate of the paper (section 6): log-linear decay, times a warm-up that eases in along a sine (JAXNeRF).

Notation: s the step, S the steps in all, W the steps of the warm-up, m the factor at step 0.

    rate(s) = exp((1 - s/S) log first + (s/S) log last)  *  (m + (1 - m) sin(pi/2 min(1, s/W)))

With the paper's numbers: 2e-4 at step 0, 1.91e-3 at step 2,500, 2e-5 at step 250,000.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp


def learning_rate(
    step: jax.Array | int,
    *,
    steps: int,
    first: float,
    last: float,
    warmup_steps: int = 0,
    warmup_factor: float = 1.0,
) -> jax.Array:
    """The rate at `step` (held at `last` beyond `steps`), as a float32 scalar; jittable in `step`."""
    progress = jnp.clip(jnp.asarray(step, jnp.float32) / steps, 0.0, 1.0)
    decayed = jnp.exp((1.0 - progress) * jnp.log(first) + progress * jnp.log(last))
    if warmup_steps <= 0:
        return decayed
    warmed = jnp.sin(0.5 * jnp.pi * jnp.clip(jnp.asarray(step, jnp.float32) / warmup_steps, 0.0, 1.0))
    return decayed * (warmup_factor + (1.0 - warmup_factor) * warmed)
