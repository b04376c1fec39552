"""How long this computer takes to train a field, before anything is begun: `python -m training.speed SIDE ...`.

SIDE: pixels along the photographs' longer side, one for each size that may be chosen.
Lines of JSON go to standard output as they are known, for programs such as the viewer:
  {"runs": {preset: {side: {"samples": that a whole run takes, "disk": bytes that its folder has in the end}}}}
  {"seconds_per_sample": as measured by training a small scene of our own for some seconds}
It ends with its standard input.

A run takes `steps` steps of about as many samples each (training.multires.settings), and nearly all of its time goes with
them.
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

PRESETS = ("quick", "normal", "full")  # of the multi-resolution field
SETTLED, TIMED = 60, 60  # steps: until programs are compiled and air is told from content; then timed
# A sample of a real run over one of the small scene, whose features stay in the processor's caches.
REAL_BY_SMALL = 1.4
DISK_BY_FINENESS = 4500.0  # bytes by cells of the finest level squared: two checkpoints of 150 MB for lego at 256


def whole_runs(sides: Sequence[int]) -> dict[str, dict[int, dict[str, int]]]:
    """Samples and bytes on the disk of a whole run, by preset and by the photographs' longer side in pixels."""
    from training.config import PRESETS as CONFIGS
    from training.multires.settings import resolutions_for, samples_for

    found: dict[str, dict[int, dict[str, int]]] = {}
    for name in PRESETS:
        config, found[name] = CONFIGS[name], {}
        for side in sides:
            samples = config.steps * (config.multires.samples_per_step or samples_for(side))
            finest = (config.multires.resolutions or resolutions_for(side))[-1]
            found[name][side] = {"samples": samples, "disk": round(DISK_BY_FINENESS * finest**2)}
    return found


def seconds_per_sample() -> float:
    """Trains a small scene for some seconds, and takes the time of its last steps."""
    import jax

    from training.config import PRESETS as CONFIGS
    from training.dataset import make_dataset
    from training.methods import make_method, settled
    from training.scenes import load_scene
    from training.scenes.procedural import write_procedural_scene

    with tempfile.TemporaryDirectory(prefix="snerg-speed-") as folder:
        scene = load_scene(write_procedural_scene(Path(folder) / "scene", size=48, views=12, subpixels=1))
        plain = CONFIGS["quick"]
        multires = dataclasses.replace(plain.multires, resolutions=(16, 32, 64, 128, 256), steps_from=(0.0, 1.0))
        config = settled(dataclasses.replace(plain, steps=SETTLED + TIMED, multires=multires))
        method = make_method(config, make_dataset(scene))
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
    print(json.dumps({"runs": whole_runs(sides)}), flush=True)
    print(json.dumps({"seconds_per_sample": seconds_per_sample()}), flush=True)


if __name__ == "__main__":
    threading.Thread(target=end_with_stdin, daemon=True).start()
    main(sys.argv[1:])
