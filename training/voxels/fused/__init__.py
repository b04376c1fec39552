"""The step of the voxel method for processors: loops compiled by Numba, in place of XLA's hundred array operations.

XLA's scatter runs on one core, and each intermediate of S samples × 8 corners × 8 channels goes through memory. Here a
ray's samples stay in cache from the march to the gradient. Same model, same losses, same state as training.voxels.step,
which stays the reference; tests/training/voxels/test_fused.py pins the two together.

    bricks   where the rows are          rays    training rays from their ids
    render   a chunk of rays, forward and backward, with the view MLP of head
    rows     total variation, scatter, Adam      vectors  rows of 8 floats as vectors, for LLVM
    passes   all of this over chunks of rays, up to each part
    step     one step, shared out among workers  engine   behind training.voxels.engine.Engine
"""

from __future__ import annotations

from pathlib import Path

from training.multires.fused.compiled import keep_compiled_code

keep_compiled_code(Path(__file__).parent)
