"""Console commands of baking and of several packages together: snerg-bake, snerg-make, snerg-eval, snerg-pack, snerg-report."""
