"""Fuzzing of all that snerg opens: packs, scenes, runs, settings. `python -m tests.fuzz --help`, or `make fuzz`."""
