"""The step of the voxel method for CPUs: one fused loop, compiled by Numba, in place of XLA's hundred array operations.

XLA's scatter runs on one core, and each intermediate of S samples × 8 corners × 8 channels goes through memory. Here a
ray's samples stay in cache from the march to the gradient. Same model, same losses, same state as training.voxels.step,
which stays the reference; tests/training/voxels/test_fused.py pins the two together.
"""
