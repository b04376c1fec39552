"""How long this computer takes to train a voxel field, before anything is begun: `python -m training.speed SIDE ... [--forward]`.

SIDE: pixels along the photographs' longer side, one for each size that may be chosen; forward: they look one way (NDC).
Lines of JSON go to standard output as they are known, for programs such as the viewer:
  {"runs": {preset: {side: {"samples": that a whole run takes, "disk": bytes that its folder has in the end}}}}
  {"seconds_per_sample": as measured by training a small scene of our own for some seconds}
It ends with its standard input.

A run takes `steps` steps of about as many samples each (training.voxels.settings), and nearly all of its time goes with
them: 0.20 to 0.40 us a sample on two quiet cores for the five captures of docs/results.md, from 200 x 200 to 800 x 800.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from training.posing.worker import end_with_stdin

PRESETS = ("cpu", "full", "fast")  # of the voxel method
SETTLED, TIMED = 90, 60  # steps: until programs are compiled and air is told from content; then timed
RESOLUTIONS, SAMPLES = (48, 96), 65_536
# A sample of a real run over one of the small scene, whose voxels stay in the processor's caches. On two quiet cores the small
# one takes 0.20 to 0.25 us; computed with this factor, the five captures take 0.8 to 1.3 times what they took.
REAL_BY_SMALL = 1.25
DISK_BY_FINENESS = 2300.0  # bytes by voxels squared: two checkpoints of 75 MB for lego at 256 voxels


def whole_runs(sides: Sequence[int], forward: bool) -> dict[str, dict[int, dict[str, int]]]:
    """Samples and bytes on the disk of a whole run, by preset and by the photographs' longer side in pixels."""
    from training.config import PRESETS as CONFIGS
    from training.voxels.settings import finest_for, samples_for

    found: dict[str, dict[int, dict[str, int]]] = {}
    for name in PRESETS:
        config = CONFIGS[name]
        voxels, found[name] = config.voxels, {}
        for side in sides:
            finest = voxels.ndc_resolutions[-1] if forward else (voxels.resolutions or (finest_for(side),))[-1]
            samples = config.steps * (voxels.samples_per_step or samples_for(finest))
            found[name][side] = {"samples": samples, "disk": round(DISK_BY_FINENESS * finest**2)}
    return found


def seconds_per_sample() -> float:
    """Trains a small scene for some seconds, and takes the time of its last steps."""
    import jax

    from training.config import PRESETS as CONFIGS
    from training.dataset import make_dataset
    from training.methods import settled
    from training.scenes import load_scene
    from training.scenes.procedural import write_procedural_scene
    from training.voxels.method import VoxelMethod

    with tempfile.TemporaryDirectory(prefix="snerg-speed-") as folder:
        scene = load_scene(write_procedural_scene(Path(folder) / "scene", size=48, views=12, subpixels=1))
        plain = CONFIGS["cpu"]
        voxels = dataclasses.replace(
            plain.voxels, resolutions=RESOLUTIONS, stage_starts=(0.0, 0.3), samples_per_step=SAMPLES,
            finer_samples_from=0.0, close_holes_from=1.0, prunings=(),
        )  # fmt: skip
        config = settled(dataclasses.replace(plain, steps=SETTLED + TIMED, voxels=voxels))
        method = VoxelMethod(config, make_dataset(scene))
        state: Any = method.start(jax.random.PRNGKey(0))
        samples, began = 0.0, 0.0
        for step in range(config.steps):
            if step == SETTLED:
                began = time.perf_counter()
            state, metrics = method.step(state, step)
            taken = float(metrics["samples"])  # waits for the step
            samples += taken if step >= SETTLED else 0.0
        return REAL_BY_SMALL * (time.perf_counter() - began) / samples


def main(words: Sequence[str]) -> None:
    """Tells all of the above."""
    sides = [int(word) for word in words if word.isdigit()]
    print(json.dumps({"runs": whole_runs(sides, "--forward" in words)}), flush=True)
    print(json.dumps({"seconds_per_sample": seconds_per_sample()}), flush=True)


if __name__ == "__main__":
    threading.Thread(target=end_with_stdin, daemon=True).start()
    main(sys.argv[1:])
