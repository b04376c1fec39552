"""A pack that knows its photographs: a tiny Blender scene on disk, its pictures rendered from the toy itself."""

import json
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from scenepack import Pack
from training.scenes import load_scene
from training.scenes.scene import cameras_of
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer

SIDE = 64
ANGLE = 0.7  # radians, horizontal


Render = Callable[[ViewCamera], np.ndarray]


def photographed(
    pack: Pack, folder: Path, per_split: int = 3, render: Render | None = None, distance: float | None = None
) -> Pack:
    """Renders photographs of `pack` into a Blender scene at `folder`; the pack with its cameras in the metadata.

    render: what draws them, uint8 [h, w, 3]; by default a context of their own. distance: as of ViewCamera.orbit.
    """
    with ExitStack() as stack:
        render = render or stack.enter_context(OffscreenRenderer(pack)).render
        for split in ("train", "test"):
            frames = []
            (folder / split).mkdir(parents=True)
            for i in range(per_split):
                azimuth = 360 * i / per_split + (30 if split == "test" else 0)
                view = ViewCamera.orbit(pack, azimuth, 25, distance, size=(SIDE, SIDE))
                focal = 0.5 * SIDE / np.tan(0.5 * ANGLE)
                view = replace(view, fx=focal, fy=focal)
                picture = np.dstack([render(view), np.full((SIDE, SIDE), 255, np.uint8)])
                Image.fromarray(picture).save(folder / split / f"r_{i}.png")
                matrix = (pack.worldspace_T_opengl @ view.grid_T_camera).tolist()
                frames.append({"file_path": f"./{split}/r_{i}", "transform_matrix": matrix})
            document = {"camera_angle_x": ANGLE, "frames": frames}
            (folder / f"transforms_{split}.json").write_text(json.dumps(document))
    return pack.with_metadata(cameras=cameras_of(load_scene(folder)), provenance={"scene": str(folder)})


def with_cameras(pack: Pack, views: Iterable[ViewCamera]) -> Pack:
    """The pack with those (grid frame) as the cameras of photographs that are nowhere."""
    cameras = []
    for i, view in enumerate(views):
        numbers = {key: getattr(view, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
        pose = (pack.worldspace_T_opengl @ view.grid_T_camera).tolist()
        lens = list(view.distortion)
        cameras.append({"name": str(i), "split": "train", "world_T_camera": pose, "distortion": lens, **numbers})
    return pack.with_metadata(cameras=cameras)
