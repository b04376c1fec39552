"""load_scene recognises a folder's layout and reads it (docs/scenes.md).

A layout is a module with LOOKED_FOR (for messages), recognises(path) and read(path, options).
"""

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError, collect_notices
from training.scenes import colmap, llff, programs, transforms
from training.scenes.files import PICTURE_SUFFIXES
from training.scenes.presets import bounded_side
from training.scenes.scene import Scene, camera_rays, pixel_grid
from training.scenes.scene_options import UP, SceneOptions, with_box

MOST_OF_A_LENS = 1e7  # pixels, or a coefficient of its distortion; beyond, some pixels have no ray
LEAST_FOCAL = 1e-3  # pixels; below, squares of the picture's own coordinates leave the range of floats
PROBES = 5  # pixels along each side of a picture whose rays are tried
AS_IT_IS = SceneOptions()
LAYOUTS = (transforms, llff, colmap, programs)  # the more particular first: others keep COLMAP's files beside their own
LOOKED_FOR = ", ".join(layout.LOOKED_FOR for layout in LAYOUTS)


def load_scene(path: str | Path, options: SceneOptions = AS_IT_IS, **changes: Any) -> Scene:
    """Reads the posed photographs in a folder; pictures are decoded when asked for. changes: single options. UserError for
    whatever is wrong with the folder, its descriptions or its pictures; a Notice of what is left out, and of guesses."""
    path, options = Path(path), replace(options, **changes)
    if not os.path.isdir(path):  # Path.is_dir raises where a name is too long
        what = "not a folder" if os.path.exists(path) else "no such folder"
        raise UserError(what, where=path, expected="a scene: a folder of photographs with camera poses")
    if not any(path.iterdir()):
        raise UserError("the folder is empty", where=path, expected="a scene: " + LOOKED_FOR)
    for layout in LAYOUTS:
        if layout.recognises(path):
            if options.up is not None and layout not in (colmap, programs):
                raise UserError("the files say themselves what is up", where=UP, found=str(path),
                                expected="a COLMAP scene, an export, or bare photographs", remedy="leave it out")  # fmt: skip
            with np.errstate(all="ignore"):  # what comes of numbers without a meaning is looked at below
                scene = replace(layout.read(path, options), notes=vars(options))
            _require_sound(scene)
            return scene if options.aabb is None else with_box(scene, options.aabb)
    what, remedy = "no scene in this folder", None
    if any(file.suffix.lower() in PICTURE_SUFFIXES for folder in (path, path / "images") for file in folder.glob("*")):
        what, remedy = "photographs without camera poses", "snerg-make finds the poses of photographs and films"
    raise UserError(what, where=path, expected="one of: " + LOOKED_FOR, remedy=remedy)


def suggested_downscale(scene: Path, longest_side: int | None) -> int:
    """The smallest whole number that brings the photographs to `longest_side` pixels or fewer, panoramas to as many for each
    quarter of a turn; 1 where that is None."""
    downscale = 1  # the reader knows of which size: the pictures of an LLFF capture may be stored shrunk
    while longest_side is not None:
        with collect_notices():  # what the reader has to say is said when training reads the scene
            camera = load_scene(scene, downscale=downscale).splits["train"][0].camera
        longest = bounded_side(camera.width, camera.height, is_panorama=camera.is_panorama)
        if longest <= longest_side:
            break
        downscale = max(downscale + 1, math.ceil(downscale * longest / longest_side))
    return downscale


def has_poses(path: Path) -> bool:
    """Whether a folder is laid out as a scene, whatever is wrong with it."""
    return os.path.isdir(path) and any(layout.recognises(path) for layout in LAYOUTS)


def _require_sound(scene: Scene) -> None:
    """UserError where cameras, rays or the box are not finite: numbers that make sense one by one may not together."""
    for photograph in [photograph for split in scene.splits.values() for photograph in split]:
        camera, where = photograph.camera, f"{scene.path}: {photograph.name}"
        if not np.isfinite(camera.world_T_camera).all():
            raise UserError("the camera cannot be placed", where=where, expected="cameras at some distance from one another",
                            remedy="check the poses")  # fmt: skip
        with np.errstate(all="ignore"):
            directions = camera_rays(camera, *pixel_grid(camera, PROBES))[1]
        numbers = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
        sound = (np.abs(numbers) < MOST_OF_A_LENS).all() and min(camera.fx, camera.fy) >= LEAST_FOCAL
        if not sound or not np.isfinite(directions).all():
            raise UserError("the camera's lens leads to no rays", where=where, found=", ".join(f"{n:g}" for n in numbers),
                            expected=f"fx, fy, cx, cy, k1, k2, p1, p2 below {MOST_OF_A_LENS:g}, fx and fy from {LEAST_FOCAL:g}"
                            )  # fmt: skip
    numbers = np.array([scene.near, scene.far, *scene.aabb.ravel()])
    if not np.isfinite(numbers).all() or (scene.aabb[0] >= scene.aabb[1]).any() or not 0 <= scene.near < scene.far:
        raise UserError("the poses say nothing of where things are", where=scene.path, expected="a box and a range of depths",
                        found=f"{scene.near:.3g} to {scene.far:.3g}", remedy="check the poses")  # fmt: skip
