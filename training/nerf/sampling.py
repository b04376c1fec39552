"""Where along a ray a field is asked: stratified coarse samples, and fine ones drawn from the coarse weights (NeRF 5.2).

Notation, per ray: t [N, K] sorted positions in [near, far]; weight [N, K] of the coarse samples; u in [0, 1) quantiles; jitter in
[0, 1), drawn by the caller. Without jitter, sampling is deterministic: what rendering uses.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

EMPTY_BIN = 1e-5  # least weight of a bin


def coarse_samples(
    jitter: jax.Array | None, near: jax.Array, far: jax.Array, count: int, disparity: bool = False
) -> jax.Array:
    """t [N, count], evenly spread over [near, far] (in 1/t with disparity), each moved within its own interval by jitter
    [N, count].
    """
    share = jnp.linspace(0.0, 1.0, count)
    near, far = near[:, None], far[:, None]
    t = 1.0 / ((1.0 - share) / near + share / far) if disparity else near * (1.0 - share) + far * share
    if jitter is None:
        return t
    middle = 0.5 * (t[:, 1:] + t[:, :-1])
    low = jnp.concatenate([t[:, :1], middle], axis=-1)
    high = jnp.concatenate([middle, t[:, -1:]], axis=-1)
    return low + (high - low) * jitter


def fine_samples(jitter: jax.Array | None, t: jax.Array, weights: jax.Array, count: int) -> jax.Array:
    """t [N, count], sorted, drawn from the piecewise-constant density that the coarse weights [N, K] describe.

    The inner weights stand for the intervals between the middles of the coarse t [N, K]. Quantiles are
    stratified, one to each of `count` equal intervals (jitter [N, count] within them). No gradient flows through the positions.
    """
    edges = 0.5 * (t[:, 1:] + t[:, :-1])
    return jax.lax.stop_gradient(inverse_cdf(jitter, edges, weights[:, 1:-1], count))


def inverse_cdf(jitter: jax.Array | None, edges: jax.Array, weights: jax.Array, count: int) -> jax.Array:
    """Stratified samples [N, count] of the histogram with edges [N, B + 1] and weights [N, B] >= 0 (not normalised)."""
    # An even trifle everywhere (NeRF's): empty rays sample evenly instead of dividing by 0, and a quantile crosses an empty
    # bin over many floats, so that the last bit of a sum, which differs between devices, moves no sample far.
    weights = weights + EMPTY_BIN
    cdf = jnp.cumsum(weights / jnp.sum(weights, axis=-1, keepdims=True), axis=-1)
    cdf = jnp.concatenate([jnp.zeros_like(cdf[:, :1]), jnp.minimum(cdf[:, :-1], 1.0), jnp.ones_like(cdf[:, :1])], -1)
    within_interval = 0.5 if jitter is None else jitter
    u = jnp.broadcast_to((jnp.arange(count) + within_interval) / count, (weights.shape[0], count))
    bin_ = jax.vmap(lambda c, q: jnp.searchsorted(c, q, side="right"))(cdf, u)
    bin_ = jnp.clip(bin_ - 1, 0, weights.shape[-1] - 1)
    c0, c1 = jnp.take_along_axis(cdf, bin_, -1), jnp.take_along_axis(cdf, bin_ + 1, -1)
    e0, e1 = jnp.take_along_axis(edges, bin_, -1), jnp.take_along_axis(edges, bin_ + 1, -1)
    within = jnp.clip((u - c0) / jnp.maximum(c1 - c0, 1e-8), 0.0, 1.0)
    return e0 + within * (e1 - e0)


def merge_samples(coarse: jax.Array, fine: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Both sets sorted together, t [N, K + F], and which of them are coarse samples, bool [N, K + F]."""
    both = jnp.concatenate([coarse, fine], axis=-1)
    order = jnp.argsort(both, axis=-1)
    return jnp.take_along_axis(both, order, axis=-1), order < coarse.shape[-1]
