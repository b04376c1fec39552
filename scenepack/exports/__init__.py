"""What other programs can open of a pack: points, meshes, Gaussians (docs/commands.md, "snerg-pack")."""
