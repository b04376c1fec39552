"""The work on chunks of rays, whole and up to each of its parts, so that a profile can take the parts apart.

A pass looks at chunks low … high - 1; all have the same arguments.
"""

# pyright: reportCallIssue=false

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numba import njit

from training.voxels.fused.head import shade_chunk
from training.voxels.fused.render import CHUNK, composite_chunk, fetch_chunk, march_chunk, render_chunk


@njit(nogil=True, cache=True)
def march_pass(low, high, bricks, rows, batch, head, numbers, work, scratch, shading):
    """Lists samples."""
    for chunk in range(low, high):
        march_chunk(chunk, bricks, batch, numbers, work, scratch)


@njit(nogil=True, cache=True)
def fetch_pass(low, high, bricks, rows, batch, head, numbers, work, scratch, shading):
    """Lists samples, fetches and activates their values."""
    for chunk in range(low, high):
        march_chunk(chunk, bricks, batch, numbers, work, scratch)
        offset, count = chunk * scratch.t.shape[0], work.counts[chunk]
        fetch_chunk(offset, count, rows, work.ids, work.weights, work.slopes, numbers.shift, scratch.pre)


@njit(nogil=True, cache=True)
def forward_pass(low, high, bricks, rows, batch, head, numbers, work, scratch, shading):
    """All but the slopes of samples; the view MLP's are there, since it is gone through forth and back at once."""
    for chunk in range(low, high):
        first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, batch.start.shape[0])
        offset, metrics = chunk * scratch.t.shape[0], work.metrics[chunk]
        march_chunk(chunk, bricks, batch, numbers, work, scratch)
        count = work.counts[chunk]
        fetch_chunk(offset, count, rows, work.ids, work.weights, work.slopes, numbers.shift, scratch.pre)
        composite_chunk(first, last, offset, batch.length, work.slopes, numbers, scratch, shading.sums, metrics)
        shade_chunk(first, last, batch, head, scratch, numbers.shaded_below, shading, metrics)


@njit(nogil=True, cache=True)
def render_pass(low, high, bricks, rows, batch, head, numbers, work, scratch, shading):
    """All: what a step does."""
    for chunk in range(low, high):
        render_chunk(chunk, bricks, rows, batch, head, numbers, work, scratch, shading)


UP_TO: Mapping[str, Any] = {
    "march": march_pass, "fetch": fetch_pass, "forward": forward_pass, "backward": render_pass,
}  # fmt: skip
