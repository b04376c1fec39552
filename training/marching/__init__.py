"""Rays through a grid: the occupancy grid (training.multires), and the grid of a bake that is culled (baker.baking.culling)."""
