"""Scenes of the four layouts: what is spoilt, and all that reading one does."""

from pathlib import Path

import numpy as np
from PIL import Image

from tests.fuzz.words import require_words
from tests.scenepack.helpers import edit_json
from tools.procedural import write_procedural_scene
from training.scenes import load_scene
from training.scenes.scene import camera_rays, picture_stems
from training.scenes.scene_options import SceneOptions, box_line
from viewer.core.files import kind_of, scene_around

BASES = ("blender", "llff", "llff-around", "transforms", "colmap", "colmap-forward")
OPTIONS = {"llff-around": SceneOptions(spherify=True), "transforms": SceneOptions(masks=True)}
DECODED = 3  # photographs of each split


def write_base(name: str, folder: Path) -> None:
    """A valid scene of a few small pictures."""
    from tests.training.reconstructions import ball, side_by_side, write_colmap
    from tests.training.test_captures import circle, forward, write_llff, write_transforms

    if name == "blender":
        write_procedural_scene(folder, size=8, views=3, subpixels=1)
        Image.open(folder / "test" / "r_1.png", formats=["PNG"]).convert("RGB").save(folder / "test" / "r_1.jpg")
    elif name.startswith("llff"):
        poses = circle(5) if name == "llff-around" else forward(5)
        write_llff(folder, poses, sizes={"images": (20, 16), "images_4": (5, 4)})
    elif name == "transforms":
        lens = {"k1": 0.1, "k2": -0.02, "p1": 0.001, "p2": -0.002, "aabb_scale": 4, "camera_model": "OPENCV"}
        write_transforms(folder, circle(4), train_filenames=["images/001.png", "images/002.png"], **lens)
        masks = [f"masks/{i}.png" for i in range(4)]
        (folder / "masks").mkdir()
        for i, mask in enumerate(masks):
            Image.new("L", (30, 20), 255 * (i % 2)).save(folder / mask)
            edit_json(folder / "transforms.json", lambda d, i=i, mask=mask: d["frames"][i].update(mask_path=mask))
    elif name == "colmap":
        write_colmap(folder, circle(5), ball(80), models=("OPENCV", "SIMPLE_RADIAL"))
    else:
        write_colmap(folder, side_by_side(5), ball(80))


def open_it(path: Path, base: str) -> None:
    """Reads it as trainer and viewer do."""
    scene = load_scene(path, OPTIONS.get(base, SceneOptions()))
    if not (np.isfinite(scene.aabb).all() and 0 <= scene.near < scene.far < np.inf and scene.splits["train"]):
        raise AssertionError("the scene has no extent")
    box_line(scene, given=False)
    for photographs in scene.splits.values():
        for name in picture_stems(photographs):
            require_words(name, 4096)
        for photograph in photographs[:DECODED]:
            rgba = photograph.load()
            photograph.load.pixels()  # type: ignore[attr-defined]
            photograph.load.thumbnail(4)  # type: ignore[attr-defined]
            if rgba.shape[:2] != (photograph.camera.height, photograph.camera.width) or not np.isfinite(rgba).all():
                raise AssertionError("the photograph does not fit its camera")
            origins, directions = camera_rays(photograph.camera)
            if not (np.isfinite(origins).all() and np.isfinite(directions).all()):
                raise AssertionError("rays lead nowhere")
    kind_of(path)
    scene_around(path)
