"""Rays through a sparse grid, whichever: the trainer's voxels (training.voxels) and a baked pack (baker.tuning.pack_layout)."""
