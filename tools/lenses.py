"""`python -m tools.lenses OUT`: a procedural scene photographed through each lens, trained, and compared on the same views.

Every 8th photograph, which is held out, is taken through a pinhole, whatever lens the others are taken through. So all runs are
measured on the same pictures. Each lens is written as transforms.json and as files of COLMAP, each in a folder of OUT.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro
from PIL import Image
from scipy.spatial.transform import Rotation

from console import run_command
from tools.procedural import picture, spread_cameras, still_life
from training.scenes.colmap_files import OPENGL_FROM_OPENCV
from training.scenes.lens import EQUIRECTANGULAR, MODELS
from training.scenes.scene import HELD_OUT_EVERY, Camera
from training.scenes.transforms import KEYS, RATIONAL

# Stronger than most lenses: without them, pictures of 64 pixels are off by up to 2 pixels.
COEFFICIENTS = {"k1": -0.5, "k2": 0.3, "k3": 0.1, "k4": -0.05, "p1": 0.02, "p2": -0.015, "q1": 0.2, "q2": 0.1, "q3": -0.1,
                "s1": 0.02, "s2": -0.01}  # fmt: skip
LENSES = ("PINHOLE", "OPENCV", "FULL_OPENCV", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE",
          "THIN_PRISM_FISHEYE", "EQUIRECTANGULAR")  # fmt: skip


def through(camera: Camera, name: str) -> Camera:
    """The camera with a lens of that model, which shows the middle as large as before."""
    model = MODELS[name]
    coefficients = {key: value for key, value in COEFFICIENTS.items() if key in model.parameters}
    if model.projection != EQUIRECTANGULAR:
        return replace(camera, distortion=model.lens(coefficients))
    width, height = round(2 * np.pi * camera.fx), round(np.pi * camera.fx)
    return Camera(camera.world_T_camera, width, height, *model.intrinsics({}, width, height), model.lens({}))


def intrinsics_of(camera: Camera) -> tuple[float, ...]:
    return camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height


def keys_of(camera: Camera, name: str) -> dict[str, object]:
    """The camera as keys of transforms.json."""
    model = MODELS[name]
    keys = KEYS[model.projection] | (RATIONAL if name == "FULL_OPENCV" else {})
    values = {keys[key]: value for key, value in COEFFICIENTS.items() if key in model.parameters}
    lens = dict(zip(("fl_x", "fl_y", "cx", "cy", "w", "h"), intrinsics_of(camera), strict=True))
    return {"camera_model": name, "transform_matrix": camera.world_T_camera.tolist(), **values, **lens}


def write_colmap(folder: Path, cameras: Sequence[Camera], names: Sequence[str]) -> None:
    """cameras.txt and images.txt; names: of the lens models."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names), 1)}
    lenses, images = {}, []
    for index, (camera, name) in enumerate(zip(cameras, names, strict=True)):
        lens = dict(zip(("fx", "fy", "cx", "cy", "w", "h"), intrinsics_of(camera), strict=True))
        values = COEFFICIENTS | lens | {"f": camera.fx}
        parameters = " ".join(repr(float(values[key])) for key in MODELS[name].parameters)
        lenses[name] = f"{numbers[name]} {name} {camera.width} {camera.height} {parameters}\n"
        camera_T_world = np.linalg.inv(camera.world_T_camera @ OPENGL_FROM_OPENCV)
        x, y, z, w = Rotation.from_matrix(camera_T_world[:3, :3]).as_quat()
        pose = " ".join(repr(float(number)) for number in (w, x, y, z, *camera_T_world[:3, 3]))
        images.append(f"{index + 1} {pose} {numbers[name]} {index:03d}.png\n\n")
    (folder / "cameras.txt").write_text("".join(lenses.values()), encoding="utf-8")
    (folder / "images.txt").write_text("".join(images), encoding="utf-8")


def lenses(
    out: tyro.conf.Positional[Path], size: int = 64, views: int = 32, steps: int = 400, only: tuple[str, ...] = LENSES
) -> None:
    """Writes, trains and compares; prints a line for each lens and layout.

    Args:
        out: Folder for the scenes and the runs.
        size: Width and height of the photographs, in pixels.
        views: Number of photographs, every 8th of which is held out.
        steps: Training steps of the preset quick.
        only: Names of COLMAP's lens models.
    """
    from baker.reports.evaluation import evaluate
    from training.config import PRESETS
    from training.loop import train
    from training.scenes import load_scene

    things = still_life(0)
    config = replace(PRESETS["quick"], steps=steps)
    for name in only:
        models = ["PINHOLE" if index % HELD_OUT_EVERY == 0 else name for index in range(views)]
        cameras = [
            through(camera, model) for camera, model in zip(spread_cameras(views, size, 0.0), models, strict=True)
        ]
        taken = [Image.fromarray(picture(things, camera, 2), "RGBA") for camera in cameras]
        for layout in ("transforms", "colmap"):
            scene = out / f"{name}-{layout}"
            (scene / "images").mkdir(parents=True, exist_ok=True)
            frames = []
            for index, (image, camera, model) in enumerate(zip(taken, cameras, models, strict=True)):
                image.save(scene / f"images/{index:03d}.png")
                frames.append({"file_path": f"images/{index:03d}.png"} | keys_of(camera, model))
            if layout == "transforms":
                (scene / "transforms.json").write_text(json.dumps({"frames": frames}), encoding="utf-8")
            else:
                write_colmap(scene / "sparse/0", cameras, models)
            run = train(scene, out / "runs" / scene.name, config)
            print(f"{name:24s} {layout:10s} {evaluate(run, load_scene(scene), 'test')['psnr']:.2f} dB", flush=True)


if __name__ == "__main__":
    sys.exit(run_command(lenses, prog="python -m tools.lenses"))
