"""How long this computer takes to train a field, before anything is begun: `python -m training.speed KIND SIDE ...`.

KIND: of scene (training.scenes.scene.Kind). SIDE: pixels along the photographs' longer side, one for each size that may be
chosen.
Lines of JSON go to standard output as they are known, for programs such as the viewer:
  {"runs": {preset: {side: {"samples": that a whole run takes, "disk": bytes that its folder has in the end}}}}
  {"seconds_per_sample": as measured by training on pictures of a ball for some seconds}
It ends with its standard input.
"""

import dataclasses
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from console.child_process import json_answers
from training.config import PRESETS as CONFIGS
from training.scenes import Camera, Photograph, Scene
from training.scenes.poses import look_at
from training.scenes.scene import Kind

PRESETS = ("quick", "normal", "full")  # of the multi-resolution field
SETTLED, TIMED = 60, 60  # steps: until programs are compiled and empty space is known; then timed
# A sample of a real run over one of the ball, whose features stay in the processor's caches.
REAL_BY_SMALL = 1.4
# Bytes of two checkpoints by cells of the finest level squared: 2 GB for lego at 512, 4 GB for fern
DISK_BY_FINENESS: Mapping[Kind, int] = {"object": 7500, "surroundings": 7500, "forward": 15_300}
HASHED_DISK = 1_500_000_000  # of unbounded scenes, whose levels share a table of fixed size


def whole_runs(sides: Sequence[int], kind: Kind) -> dict[str, dict[int, dict[str, int]]]:
    """Samples and bytes on the disk of a whole run, by preset and by the photographs' longer side in pixels."""
    from training.multires.settings import resolutions_for, samples_for

    finest = {side: resolutions_for(side)[-1] for side in sides}
    disk = {
        side: DISK_BY_FINENESS[kind] * finest[side] ** 2 if kind in DISK_BY_FINENESS else HASHED_DISK for side in sides
    }
    steps = {name: CONFIGS[name].steps for name in PRESETS}
    return {
        name: {side: {"samples": steps[name] * samples_for(side, kind), "disk": disk[side]} for side in sides}
        for name in PRESETS
    }


def _ball() -> Scene:
    """A ball of radius 1 about the origin, from 12 cameras on a circle around it, 4 from its centre and 48 pixels wide."""
    side, focal = 48, 66.0
    from_centre = np.arange(side) + 0.5 - side / 2
    picture = np.full((side, side, 4), 0.5, np.float32)
    picture[..., 3] = np.hypot(from_centre, from_centre[:, None]) < focal / np.sqrt(4**2 - 1)
    photographs = []
    for angle in np.linspace(0.0, 2 * np.pi, 12, endpoint=False):
        eye = 4 * np.array([np.cos(angle), np.sin(angle), 0.0])
        camera = Camera(look_at(eye, eye, np.array([0.0, 0.0, 1.0])), side, side, focal, focal, side / 2, side / 2)
        photographs.append(Photograph(f"{len(photographs)}", camera, lambda: picture))
    box = np.array([[-1.3] * 3, [1.3] * 3])
    return Scene(2.0, 6.0, box, np.eye(4), path=Path("ball"), kind="blender", splits={"train": tuple(photographs)})


def seconds_per_sample() -> float:
    """Trains on the ball for some seconds, and takes the time of the last steps."""
    import jax

    from training.dataset import make_dataset
    from training.run import make_method, settled

    plain = CONFIGS["quick"]
    multires = dataclasses.replace(plain.multires, resolutions=(16, 32, 64, 128, 256), steps_from=(0.0, 1.0))
    config = settled(dataclasses.replace(plain, steps=SETTLED + TIMED, multires=multires))
    method = make_method(config, make_dataset(_ball()))
    state: Any = method.start(jax.random.PRNGKey(0))
    samples, began = 0.0, 0.0
    for step in range(config.steps):
        if step == SETTLED:
            began = time.perf_counter()
        state, metrics = method.step(state, step)
        taken = float(metrics["samples"])  # waits for the step
        samples += taken if step >= SETTLED else 0.0
    return REAL_BY_SMALL * (time.perf_counter() - began) / samples


if __name__ == "__main__":
    answer = json_answers()
    kind, *sides = sys.argv[1:]
    answer(runs=whole_runs([int(side) for side in sides], kind))  # pyright: ignore[reportArgumentType]
    answer(seconds_per_sample=seconds_per_sample())
