"""The fast field: a sparse voxel grid optimised directly, with empty space skipped (see training.voxels.method)."""
