"""Scenes of our own, rendered from shapes and written in Blender layout: test fixture and bundled demo.

    python -m tools.procedural OUT --scene island --size 400 --views 96 --seed 0

Deterministic by seed, views and size. The still life and the scenes of `stress` are quick to draw: see shapes, shading and
tracing (how). The island is the bundled demo; see island.
"""

import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image

from console import progress
from tools.procedural.shading import Thing
from tools.procedural.still_life import still_life
from tools.procedural.stress import glass, wires
from tools.procedural.tracing import picture
from training.scenes.poses import look_at
from training.scenes.scene import Camera

Arrangement = Literal["still-life", "glass", "wires", "island"]
ARRANGEMENTS: Mapping[str, Callable[[int], list[Thing]]] = {"still-life": still_life, "glass": glass, "wires": wires}
DISTANCE = 4.0311  # of the cameras from the origin, as in NeRF-synthetic
CAMERA_ANGLE_X = 0.6911112  # horizontal field of view in radians, likewise
LOOK_AT, UP = np.array([0.0, 0.0, -0.12]), np.array([0.0, 0.0, 1.0])


def spread_cameras(count: int, size: int, phase: float) -> list[Camera]:
    """Cameras on a golden spiral over the upper hemisphere, from 4 to 72 degrees of elevation."""
    focal = 0.5 * size / np.tan(0.5 * CAMERA_ANGLE_X)
    share = (np.arange(count) + 0.5) / count
    z = np.sin(np.radians(4)) + share * (np.sin(np.radians(72)) - np.sin(np.radians(4)))
    azimuth = (np.arange(count) + phase) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z * z)
    eyes = DISTANCE * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], -1)
    return [Camera(look_at(eye, eye - LOOK_AT, UP), size, size, focal, focal, size / 2, size / 2) for eye in eyes]


def drawn(arrangement: Arrangement, seed: int, subpixels: int) -> Callable[[Camera], np.ndarray]:
    """What draws `arrangement` as a camera sees it: uint8 [H, W, 4], transparent background, RGB not premultiplied."""
    if arrangement == "island":
        from tools.procedural.island import island_picture, make_island  # numba compiles it

        island = make_island(seed)
        return lambda camera: island_picture(island, camera, subpixels)
    things = ARRANGEMENTS[arrangement](seed)
    return lambda camera: picture(things, camera, subpixels)


def write_procedural_scene(
    out: Path,
    *,
    size: int,
    views: int,
    subpixels: int,
    arrangement: Arrangement = "still-life",
    seed: int = 0,
) -> Path:
    """Renders a scene into `out` in Blender layout and returns `out`.

    arrangement: what there is. size: pixels a side. views: training views; a sixth as many test views, at least two, lie between
    them. subpixels: rays a side of a pixel. The folder is made; pictures of the same names are replaced.
    """
    out = Path(out)
    draw = drawn(arrangement, seed, subpixels)
    splits = {"train": spread_cameras(views, size, 0.0), "test": spread_cameras(max(2, views // 6), size, 0.5)}
    jobs = []
    for split, cameras in splits.items():
        (out / split).mkdir(parents=True, exist_ok=True)
        frames = [
            {"file_path": f"./{split}/r_{i}", "transform_matrix": camera.world_T_camera.tolist()}
            for i, camera in enumerate(cameras)
        ]
        document = {"camera_angle_x": CAMERA_ANGLE_X, "frames": frames}
        (out / f"transforms_{split}.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        jobs += [(camera, out / split / f"r_{i}.png") for i, camera in enumerate(cameras)]

    def render(job: tuple[Camera, Path]) -> None:
        Image.fromarray(draw(job[0]), "RGBA").save(job[1], optimize=False)

    with progress("procedural scene", len(jobs)) as bar, ThreadPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(render, jobs):
            bar.advance()
    return out
