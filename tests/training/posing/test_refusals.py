"""Why no poses are found, told in one plain line; and masks, which remedy one of the reasons."""

import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from baker.commands.make import main as snerg_make
from console import Notice, UserError
from tests.fuzz.trees import write_tree
from tests.training.posing.conftest import load_quietly
from tests.training.posing.rooms import TILE, bilinear, texture
from training.posing.find import posed_scene
from training.scenes.sources import require_source

COUNT = 8
# A textured ball that turns before a textured wall, and a camera that stands still.
SIZE = (320, 240)
RADIUS, DISTANCE = 1.0, 3.4  # of the ball, and of the camera from its centre
FOCAL = 330.0  # pixels
STEP = 8.0  # degrees from one picture to the next
SHOWN = 0.6  # of a texture lies around half the ball
TURNED = Image.Transpose.ROTATE_90, 6  # how a camera that is held upright stores a picture, and what EXIF says then


def turned_photograph(turned: float) -> tuple[np.ndarray, np.ndarray]:
    """The picture uint8 [H, W, 3] with the ball turned by some degrees, and where the ball is, bool [H, W]."""
    width, height = SIZE
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    directions = np.stack([x, -y, np.full_like(x, -FOCAL)], axis=-1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    along = -DISTANCE * directions[..., 2]  # of the point on the ray that is nearest to the centre
    within = RADIUS**2 - (DISTANCE**2 - along**2)
    ball = within > 0
    points = directions * (along - np.sqrt(np.maximum(within, 0)))[..., None] + [0, 0, DISTANCE]
    angle = (np.degrees(np.arctan2(points[..., 0], points[..., 2])) + turned + 90) / 180 * SHOWN
    level = 0.2 * (points[..., 1] / RADIUS + 1) + 0.1
    picture = texture(51)[:height, :width].copy()
    picture[ball] = bilinear(texture(50), *(np.clip(at[ball], 0, 0.998) * (TILE - 1) for at in (level, angle)))
    return picture.astype(np.uint8), ball


def write_turntable(folder: Path, masks: Callable[[str], str | None] = lambda name: None) -> None:
    """Photographs of a turntable, the last one stored sideways. masks: the name of each photograph's mask, None for none."""
    (folder / "masks").mkdir(parents=True)
    for i in range(COUNT):
        picture, ball = turned_photograph(i * STEP)
        name = f"t{i}.png"
        image, mask = Image.fromarray(picture), Image.fromarray(ball.astype(np.uint8) * 255)
        exif = Image.Exif()
        if i == COUNT - 1:
            image, mask, exif[0x0112] = image.transpose(TURNED[0]), mask.transpose(TURNED[0]), TURNED[1]
        image.save(folder / name, exif=exif)
        if (mask_name := masks(name)) is not None:
            mask.save(folder / "masks" / mask_name)
    if not any((folder / "masks").iterdir()):
        (folder / "masks").rmdir()


def refusal(photographs: Path, out: Path) -> str:
    with warnings.catch_warnings(action="ignore"), pytest.raises(UserError) as error:
        posed_scene(photographs, out)
    return str(error.value)


@pytest.mark.slow
def test_a_turntable_before_a_still_background_is_refused_unless_it_has_masks(tmp_path):
    write_turntable(tmp_path / "bare")
    message = refusal(tmp_path / "bare", tmp_path / "out")
    assert "the camera stands still" in message and "put a folder masks with t0.png" in message
    write_turntable(tmp_path / "masked", lambda name: f"{name}.png" if name != "t1.png" else "t1_mask.png")
    scene = load_quietly(posed_scene(tmp_path / "masked", tmp_path / "out"), masks=True)
    photographs = [one for split in scene.splits.values() for one in split]
    assert len(photographs) == COUNT
    turns = {one.name: one.camera.world_T_camera[:3, :3] for one in photographs}
    for a, b in pairwise(f"t{i}.png" for i in range(COUNT)):
        angle = np.degrees(np.arccos((np.trace(turns[a].T @ turns[b]) - 1) / 2))
        assert abs(angle - STEP) < 0.5
    _, ball = turned_photograph((COUNT - 1) * STEP)
    last = next(one for one in photographs if one.name == f"t{COUNT - 1}.png").load()
    assert np.abs(last[..., 3] - ball).mean() < 0.01  # the mask was turned with its photograph


@pytest.mark.slow
def test_masks_that_do_not_fit_or_are_missing_are_told(tmp_path: Path):
    write_turntable(tmp_path / "photographs", lambda name: f"{name}.png")
    assert len(require_source(tmp_path / "photographs").files) == COUNT  # the masks are none
    Image.new("L", (64, 64)).save(tmp_path / "photographs" / "masks" / "t3.png.png")
    message = refusal(tmp_path / "photographs", tmp_path / "out")
    assert "t3.png.png: the mask is of another size than its photograph (expected 320x240, found 64x64)" in message
    (tmp_path / "photographs" / "masks" / "t3.png.png").unlink()
    with pytest.warns(Notice, match=r"1 photograph has no mask, all of it is used \(t3\.png\)"):
        posed_scene(tmp_path / "photographs", tmp_path / "out")


@pytest.mark.parametrize("more", [["--poses-only"], ["--no-view"]])
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none", None, "no such file or folder"),
        ("n\udce4", {}, "the folder is empty"),
        ("folder", {"notes.txt": b"hello"}, "no photographs and no film in this folder"),
        ("psd", {"a.psd": b"", "b.psd": b""}, "2 PSD pictures"),
        ("walk.mp4", b"hello", "found text that begins 'hello'"),
        ("notes.txt", b"", "found an empty file"),
        ("photograph", b"\xff\xd8\xff\xe0" + bytes(2000), "found a JPEG"),
        ("walk.mov", b"\0\0\0\x18ftypavif" + bytes(99), "found an AVIF"),
        ("photographs.zip", b"PK\x03\x04", "found a ZIP archive); unpack the archive"),
        ("zipped", {"photographs.zip": b"PK\x03\x04"}, "found photographs.zip); unpack the archive"),
        ("walk.gif", b"GIF89a", "found a GIF); convert them to JPEG or PNG"),
        ("walk.insv", b"\0\0\0\x18ftypavc1", "export panoramas (360°, equirectangular) as JPEG or MP4"),
        ("transforms.json", b'{"frames": []}', "name the folder that it is in"),
        ("scene", {"transforms.json": b"{}"}, "transforms.json"),
        ("three", {"a.jpg": b"", "b.jpg": b"", "c.jpg": b""}, "find camera poses (expected at least 8, found 3)"),
    ],
)
def test_snerg_make_of_nothing_is_refused_in_one_line(name, content, message, more, tmp_path, refused):
    path, out = tmp_path / name, tmp_path / "out"
    if isinstance(content, dict):
        write_tree(content, path)
    elif content is not None:
        path.write_bytes(content)
    line = refused(snerg_make, path, "--out", out, *more)
    assert message in line and str(tmp_path) in line
    assert name in ("scene", "three") or all(kind in line for kind in ("JPEG", "HEIC", "MP4", "AVI", "Matroska"))
    assert not out.exists()


@pytest.mark.slow
def test_photographs_that_share_nothing_are_refused_by_name(real_data: Path, tmp_path: Path) -> None:
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    for name, scene in (("fox", "transforms_json/fox/images"), ("fern", "nerf_llff_data/fern/images_4")):
        with Image.open(sorted((real_data / scene).iterdir())[3], formats=["JPEG", "PNG"]) as picture:
            w, h = (n // 2 for n in picture.size)
            for i in range(4):
                at = (i % 2 * w, i // 2 * h)
                quarter = picture.convert("RGB").crop((*at, at[0] + w, at[1] + h))
                quarter.save(photographs / f"{name}{i}.jpg", quality=92)
    with pytest.raises(UserError, match=r"do not overlap enough.* match no other: fern0\.jpg, fern1\.jpg"):
        posed_scene(photographs, tmp_path / "out")
