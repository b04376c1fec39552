"""Rays through a sparse grid, whichever: the occupancy grid (training.multires) and a baked pack (baker.tuning.pack_layout)."""
