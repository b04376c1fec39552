"""Where things are in captures that come with camera poses but without points: features that match between two photographs lie
where their rays come closest to one another.

Notation: K matches; rays o + s·d of both features, float64 [K, 2, 3], d of unit length.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from console import UserError, progress
from training.posing.check import LONGEST_SIDE, match_small
from training.posing.prepare import IMAGES, CameraGroup
from training.scenes import Photograph, Scene
from training.scenes.files import notice
from training.scenes.pictures import as_bytes
from training.scenes.scene import camera_rays
from training.scenes.scene_options import with_box
from training.scenes.space import PointCloud, rows_in_picture, space_of_capture

MOST_PHOTOGRAPHS = 120  # that are matched; of more, so many at even distances
LEAST_ANGLE = 2.0  # degrees between two rays; where narrower ones come closest is uncertain
MOST_APART = 0.01  # of the distance from the nearer camera: rays farther apart do not meet
FEWEST_MEET = 0.5  # of the matches; where fewer do, poses or lens do not fit the photographs
# Median gap, as MOST_APART: 0.0006 to 0.0011 in bear, fox and stone_horse, 0.0066 in fox with poses that drift by 0.5° and 1 %.
INACCURATE = 0.0025
GUESS = "how near things are is a guess"
REMEDY = "If poses or lens are inaccurate: snerg-make with --find-poses (in the window: New poses) finds them anew"


def with_depths(scene: Scene) -> Scene:
    """The scene with near, far and box of what its training photographs show, where these were a guess. They stay one, and
    a Notice says so, where features are few or the poses do not fit them, or pycolmap is missing."""
    if not scene.guessed:
        return scene
    if find_spec("pycolmap") is None:
        notice(scene.path, f"{GUESS}; pip install 'snerg[poses]' lets snerg find it from the photographs")
        return scene
    photographs = scene.splits["train"]
    try:
        origins, directions = _matching_rays(photographs[:: -(-len(photographs) // MOST_PHOTOGRAPHS)])
    except (UserError, RuntimeError) as error:  # training can do without; the log that it names is gone
        notice(scene.path, f"{GUESS}: matching features failed: {str(error).partition('; see ')[0]}")
        return scene
    places, meeting, apart = meeting_places(origins, directions)
    cameras = [photograph.camera for photograph in photographs]
    points = PointCloud(places, np.ones(len(places)), [rows_in_picture(camera, places) for camera in cameras])
    if not points.suffices:
        notice(scene.path, f"{GUESS}: only {len(places)} features of the photographs match")
        return scene
    if meeting < FEWEST_MEET:
        text = f"only {meeting:.0%} of the matching features lie where the camera poses say"
        notice(scene.path, f"{GUESS}: {text}. {REMEDY}")
        return scene
    if apart > INACCURATE:
        pixels = f"{apart * cameras[0].fx:.1f} of {cameras[0].width} pixels"
        notice(scene.path, f"matching features lie {pixels} from where the camera poses say. {REMEDY}")
    found = space_of_capture(cameras, points, opaque=True)
    scene = replace(scene, near=found.near, far=found.far, aabb=found.aabb, guessed=False)
    box: Any = scene.notes.get("aabb")
    return scene if box is None else with_box(scene, box)


def meeting_places(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, float, float]:
    """For pairs of rays [K, 2, 3]: where they meet, [M, 3]; the share of pairs that do; and the median gap between the rays of
    a pair, as a share of the distance to the nearer camera. A pair meets in the middle of the shortest line between its rays.
    Pairs at less than LEAST_ANGLE do not count."""
    (a, b), between = np.moveaxis(directions, 1, 0), origins[:, 0] - origins[:, 1]
    cosine = (a * b).sum(-1)
    wide = cosine < np.cos(np.radians(LEAST_ANGLE))
    a, b, between, cosine, origins = (values[wide] for values in (a, b, between, cosine, origins))
    along_a, along_b = (a * between).sum(-1), (b * between).sum(-1)
    distances = np.stack([cosine * along_b - along_a, along_b - cosine * along_a], -1) / (1.0 - cosine**2)[:, None]
    closest = origins + distances[..., None] * np.stack([a, b], 1)
    front = (distances > 0).all(-1)
    apart = np.linalg.norm(closest[front, 0] - closest[front, 1], axis=-1) / distances[front].min(-1)
    places = closest[front][apart < MOST_APART].mean(1)
    return places, len(places) / max(len(closest), 1), float(np.median(apart)) if len(apart) else 0.0


def _matching_rays(photographs: Sequence[Photograph]) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions [K, 2, 3] of features that match, between any two of the photographs."""
    with tempfile.TemporaryDirectory(prefix="snerg-depths-") as folder, progress("finding depths", 3) as bar:
        work, numbers = Path(folder), {}
        (work / IMAGES).mkdir()
        groups: dict[tuple[tuple[int, int], bool], list[str]] = {}
        for index, photograph in enumerate(photographs):
            picture = Image.fromarray(as_bytes(photograph.load()[..., :3]))
            picture.thumbnail((LONGEST_SIDE, LONGEST_SIDE), Image.Resampling.BOX)
            name = f"{index:04d}.png"
            picture.save(work / IMAGES / name)
            numbers[name] = index
            groups.setdefault((picture.size, photograph.camera.is_panorama), []).append(name)
            bar.update((index + 1) / len(photographs))
        by_camera = [CameraGroup(names, None, is_panorama) for (_, is_panorama), names in groups.items()]
        pairs = match_small(work, list(numbers), by_camera, bar, begun=1.0)["pairs"]
    found = [np.zeros((2, 0, 2, 3))]
    for pair in pairs:
        cameras = [photographs[numbers[pair[end]]].camera for end in ("first", "second")]
        shares = np.split(np.array(pair["places"]), 2, axis=1)
        at = [share * (camera.width, camera.height) for share, camera in zip(shares, cameras, strict=True)]
        rays = [np.stack(camera_rays(camera, *xy.T)) for xy, camera in zip(at, cameras, strict=True)]
        found.append(np.stack(rays, axis=2))
    origins, directions = np.concatenate(found, axis=1)
    return origins, directions
