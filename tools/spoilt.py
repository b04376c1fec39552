"""`python -m tools.spoilt SCENE OUT`: a capture, worse versions of it, what the check says of each, and the PSNR that it reaches.

Versions, each a scene in a folder of OUT: whole; blurred; third, every third photograph alone; exposure, in turns darker and
brighter. All are tested on the same photographs, which are held out, as sharp and as bright as they were.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import tyro
from PIL import Image, ImageFilter

from console import run_command
from training.scenes import SceneOptions, load_scene
from training.scenes.scene import Photograph

EXPOSURES = (1.0, 0.6, 1.5, 0.8)
BLUR = 2.5  # pixels, standard deviation
VERSIONS = ("whole", "blurred", "third", "exposure")


def spoilt(pixels: np.ndarray, index: int, version: str) -> Image.Image:
    """A photograph, float [H, W, 4] in [0, 1], in that version; opaque ones without alpha."""
    if version == "exposure":
        pixels = pixels * [*[EXPOSURES[index % len(EXPOSURES)]] * 3, 1.0]
    picture = Image.fromarray(np.round(255 * np.clip(pixels, 0, 1)).astype(np.uint8), "RGBA")
    if pixels[..., 3].min() == 1.0:
        picture = picture.convert("RGB")
    return picture.filter(ImageFilter.GaussianBlur(BLUR)) if version == "blurred" else picture


def write_version(
    folder: Path, train: tuple[Photograph, ...], test: tuple[Photograph, ...], version: str
) -> None:  # fmt: skip
    """transforms.json, `images` to train on, and `held_out`."""
    if version == "third":
        train = train[::3]
    frames = []
    for split, photographs in (("images", train), ("held_out", test)):
        (folder / split).mkdir(parents=True, exist_ok=True)
        for index, photograph in enumerate(photographs):
            file, camera = f"{split}/{index:03d}.png", photograph.camera
            spoilt(photograph.load(), index, version if split == "images" else "whole").save(folder / file)
            lens = dict(zip(("k1", "k2", "p1", "p2"), camera.distortion, strict=True))
            frames.append({
                "file_path": file, "transform_matrix": camera.world_T_camera.tolist(), "camera_model": "OPENCV", **lens,
                "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height,
            })  # fmt: skip
    names = {f"{use}_filenames": [frame["file_path"] for frame in frames if frame["file_path"].startswith(split)]
             for use, split in (("train", "images"), ("test", "held_out"))}  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps({"frames": frames} | names), encoding="utf-8")


def main(
    scene: tyro.conf.Positional[Path], out: tyro.conf.Positional[Path], downscale: int = 1, masks: bool = False,
    steps: int = 2000,
) -> None:  # fmt: skip
    """Writes, checks, trains and tests; prints a line for each version, and writes it into OUT/figures.json.

    Args:
        scene: A scene with poses.
        out: Folder for the versions.
        downscale: Of the photographs that are checked, best about 500 pixels; half as many are trained on.
        masks: Cut the object out by masks.
        steps: Training steps of the preset quick.
    """
    from baker.reports.evaluation import evaluate
    from training.config import PRESETS
    from training.loop import train
    from training.posing.check import check
    from training.scenes.sources import require_source

    loaded, half, figures = load_scene(scene, downscale=downscale, masks=masks), SceneOptions(downscale=2), {}
    for version in VERSIONS:
        folder = out / version
        write_version(folder, loaded.splits["train"], loaded.splits["test"], version)
        verdict = check(require_source(folder / "images"), out / f"{version}.html", 120)
        run = train(folder, out / "runs" / version, replace(PRESETS["quick"], steps=steps), half)
        psnr = evaluate(run, load_scene(folder, half), "test")["psnr"]
        figures[version] = {"psnr": psnr} | verdict.figures
        print(
            f"{scene.name:12s} {version:10s} expected {verdict.figures['expected_psnr']:.1f}, {psnr:.2f} dB", flush=True
        )
        (out / "figures.json").write_text(json.dumps(figures, indent=1), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(run_command(main, prog="python -m tools.spoilt"))
