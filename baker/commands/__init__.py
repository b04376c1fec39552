"""Console commands of this room, and those that join rooms: snerg-bake, snerg-make, snerg-eval."""
