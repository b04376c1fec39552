"""Trains both methods for 50 steps on the devices that this process finds: a child process of test_many_devices.

python -m tests.training.train_both SCENE OUT [COORDINATOR PROCESSES PROCESS_ID]
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

from training.config import PRESETS, TINY, TrainConfig
from training.devices import join_processes
from training.voxels import settings
from training.voxels.config import VoxelConfig

EVERY = {"steps": 50, "log_every": 1, "checkpoint_every": 25, "validate_every": 0}
# NeRF's endless last interval makes a ray opaque or clear by the sign of one density: the last bit of a sum would show.
NERF = dataclasses.replace(
    TINY,
    batch_size=128,
    **EVERY,
    nerf=dataclasses.replace(
        TINY.nerf, depth=2, width=16, skip_after=0, coarse_samples=8, fine_samples=8, warmup_steps=5, last_interval=0.5
    ),
)
VOXELS = dataclasses.replace(
    PRESETS["cpu"],
    **EVERY,
    batch_size=512,
    voxels=VoxelConfig(resolutions=(12, 24), stage_starts=(0.0, 0.5), prunings=(), samples_per_step=4096),
)
CONFIGS: dict[str, TrainConfig] = {"nerf": NERF, "voxels": VOXELS}


def main(scene: str, out: str, coordinator: str = "", processes: str = "1", process_id: str = "0") -> None:
    if coordinator:
        join_processes(coordinator, int(processes), int(process_id))
    settings.SETTLING_STEPS = 10  # so that a refinement falls within 50 steps
    from training.loop import train

    for name, config in CONFIGS.items():
        train(scene, Path(out) / name, config)


if __name__ == "__main__":
    main(*sys.argv[1:])
