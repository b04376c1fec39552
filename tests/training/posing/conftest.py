"""Photographs of the room as different cameras write them, and the scene that comes of them, found once for all tests."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from console import collect_notices
from tests.training.posing.rooms import cameras, photograph, texture
from training.posing.find import find_poses
from training.scenes import Camera, Scene, load_scene
from training.scenes.sources import Source, require_source

COUNT = 9
SIDEWAYS, SMALLER, STRANGER = 1, 7, "stranger.jpg"


@dataclass(frozen=True)
class Found:
    """A set of photographs, where their cameras stood, by name, and the scene that was made of it."""

    source: Source
    cameras: dict[str, Camera]
    scene: Path
    notices: list[str]


def write_photographs(folder: Path, count: int = COUNT) -> dict[str, Camera]:
    """Photographs as cameras, phones and scanners write them. The cameras by the names that the pictures get in a scene."""
    folder.mkdir(parents=True, exist_ok=True)
    given, exif = {}, Image.Exif()
    exif[0x0112] = 6
    # SIDEWAYS, it was held upright: pixels are stored turned by 90° counter-clockwise, and EXIF says so
    written: dict[int, Callable[[Image.Image], Image.Image]] = {
        SIDEWAYS: lambda picture: picture.transpose(Image.Transpose.ROTATE_90),
        2: lambda picture: Image.fromarray(np.asarray(picture.convert("L")).astype(np.uint16) * 257),
        3: lambda picture: picture.convert("CMYK"),
        SMALLER: lambda picture: picture.resize((192, 144), Image.Resampling.BOX),
    }
    for i, camera in enumerate(cameras(count)):
        name = {2: "p2.png", 3: "p3.tif", 4: "p 4.JPG", 5: "p5.webp"}.get(i, f"p{i}.jpg")
        picture = written.get(i, lambda picture: picture)(Image.fromarray(photograph(camera)))
        picture.save(folder / name, quality=95, exif=exif if i == SIDEWAYS else b"")
        given[name.replace(" ", "_").split(".")[0]] = camera
    return given


def load_quietly(scene: Path, *, masks: bool = False) -> Scene:
    """The scene as seen from all around."""
    with warnings.catch_warnings(action="ignore"):
        return load_scene(scene, spherify=True, masks=masks)


@pytest.fixture(scope="session")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    folder = tmp_path_factory.mktemp("posing")
    photographs = folder / "photographs"
    given = write_photographs(photographs)
    (photographs / "p0b.jpg").write_bytes((photographs / "p0.jpg").read_bytes())
    sharp = Image.open(photographs / "p6.jpg", formats=["JPEG"])
    sharp.filter(ImageFilter.GaussianBlur(4)).save(photographs / "p6b.jpg")
    Image.fromarray(texture(105)[:192, :256].astype(np.uint8)).save(photographs / STRANGER, quality=95)
    source = require_source(photographs)
    with collect_notices() as notices:
        scene = find_poses(source, folder / "out")
    return Found(source, given, scene, notices)
