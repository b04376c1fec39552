"""The terms of the paper's training loss (SNeRG sections 4.1 and 4.3) and PSNR.

The paper sums over rays; a batch is a sample of rays, so we divide both terms by the number of rays in it. That changes the
size of the gradient, not the balance of the terms.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

CHANNELS = 3


def squared_error(rgb: jax.Array, target: jax.Array) -> jax.Array:
    """L_r per ray: mean over rays of |C - C_hat|^2, for rgb and target [N, 3]. CHANNELS times the MSE per channel."""
    return jnp.mean(jnp.sum(jnp.square(rgb - target), axis=-1))


def cauchy_sparsity(sigma: jax.Array, c: float = 0.5) -> jax.Array:
    """L_s / lambda_s per ray: mean over rays of the sum over samples of log(1 + sigma^2 / c); sigma [N, K]."""
    return jnp.mean(jnp.sum(jnp.log1p(jnp.square(sigma) / c), axis=-1))


def mean_squared_error(rgb: jax.Array, target: jax.Array) -> jax.Array:
    """Mean over rays and channels, of colours clamped to [0, 1] as a picture would show them: what PSNR is made of."""
    return jnp.mean(jnp.square(jnp.clip(rgb, 0.0, 1.0) - target))


def psnr_of(mse: jax.Array) -> jax.Array:
    """Peak signal-to-noise ratio in dB of an MSE of colours in [0, 1]."""
    return -10.0 * jnp.log10(jnp.maximum(mse, 1e-12))
