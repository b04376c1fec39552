"""A mask shows the same whatever program wrote it: alpha, 0 and 1, palettes, other sizes, or turned with its photograph."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from console import Notice, UserError
from training.dataset import make_dataset
from training.posing.prepare import prepare
from training.scenes import Photograph, Scene, load_pixels
from training.scenes.pictures import PictureLoader, read_mask
from training.scenes.sources import find_source

SIZE = WIDTH, HEIGHT = 48, 32
SHOWN = np.zeros((HEIGHT, WIDTH), bool)
SHOWN[8:24, 4:20] = True
WHITE = SHOWN.astype(np.uint8) * 255


def of_palette(hidden: Sequence[int], shown: Sequence[int], **options: int) -> Image.Image:
    image = Image.fromarray(SHOWN.astype(np.uint8)).convert("P")
    image.putpalette([*hidden, *shown])
    image.info.update(options)
    return image


def of_alpha(colour: Sequence[int], alpha: np.ndarray = WHITE) -> Image.Image:
    return Image.fromarray(np.dstack([np.broadcast_to(np.uint8(colour), (HEIGHT, WIDTH, len(colour))), alpha]))


PHOTO = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
LEFT = np.where(np.arange(WIDTH) < 30, 255, 0).astype(np.uint8)
MASKS: dict[str, Callable[[], Image.Image]] = {
    "black and white": lambda: Image.fromarray(WHITE),
    "rgb": lambda: Image.fromarray(WHITE).convert("RGB"),
    "1 bit": lambda: Image.fromarray(WHITE).convert("1"),
    "0 and 1": lambda: Image.fromarray(WHITE // 255),
    "0 and 128": lambda: Image.fromarray(WHITE // 2),
    "numbers of objects": lambda: Image.fromarray(SHOWN * (1 + np.arange(WIDTH) % 5).astype(np.uint8)),
    "16 bit": lambda: Image.fromarray(WHITE.astype(np.uint16) * 257),
    "16 bit, 0 and 1": lambda: Image.fromarray(SHOWN.astype(np.uint16)),
    "16 bit, 0 and 255": lambda: Image.fromarray(WHITE.astype(np.uint16)),
    "alpha, black": lambda: of_alpha((0, 0, 0)),
    "alpha, white": lambda: of_alpha((255, 255, 255)),
    "alpha, grey": lambda: of_alpha((255,)),
    "alpha, 0 and 1": lambda: of_alpha((255, 0, 0), WHITE // 255),
    "opaque rgba": lambda: Image.fromarray(WHITE).convert("RGBA"),
    "rgba, forgotten alpha": lambda: Image.fromarray(np.dstack([WHITE] * 3 + [WHITE * 0])),
    "painted white, erased black": lambda: Image.fromarray(np.dstack([WHITE] * 3 + [WHITE | LEFT])),
    "cut-out photograph": lambda: Image.fromarray(np.dstack([PHOTO, WHITE])),
    "cut-out photograph with black": lambda: Image.fromarray(np.dstack([PHOTO * (PHOTO > 99), WHITE])),
    "palette, black and green": lambda: of_palette((0, 0, 0), (0, 255, 0)),
    "palette, black and dark blue": lambda: of_palette((0, 0, 0), (0, 0, 30)),
    "palette, purple and yellow": lambda: of_palette((68, 1, 84), (253, 231, 37)),
    "palette, transparent": lambda: of_palette((255, 255, 255), (255, 255, 255), transparency=0),
    "coloured objects": lambda: Image.fromarray(PHOTO // 2 * SHOWN[..., None] + np.uint8([0, 40, 0]) * SHOWN[..., None]),
}  # fmt: skip


def photograph(folder: Path, *, orientation: int = 1, size: tuple[int, int] = SIZE) -> Path:
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.new("RGB", size, (200, 100, 50)).save(folder / "a.jpg", exif=exif)
    return folder / "a.jpg"


@pytest.mark.parametrize("kind", MASKS)
def test_masks_of_any_kind_show_the_same_posed_and_bare(tmp_path: Path, kind: str) -> None:
    path, mask = photograph(tmp_path), tmp_path / "mask.png"
    MASKS[kind]().save(mask)
    load = PictureLoader(path, SIZE, SIZE, mask)
    np.testing.assert_array_equal(load()[..., 3], SHOWN)
    np.testing.assert_array_equal(load.pixels()[..., 3], WHITE)
    np.testing.assert_array_equal(np.asarray(load.thumbnail(WIDTH))[..., 3], WHITE)


def test_a_soft_mask_keeps_its_values_and_jpeg_its_ends(tmp_path: Path) -> None:
    path, ramp = photograph(tmp_path), np.tile(np.linspace(0, 250, WIDTH).astype(np.uint8), (HEIGHT, 1))
    Image.fromarray(ramp).save(tmp_path / "soft.png")
    np.testing.assert_array_equal(PictureLoader(path, SIZE, SIZE, tmp_path / "soft.png").pixels()[..., 3], ramp)
    Image.fromarray(WHITE).save(tmp_path / "mask.jpg", quality=90)
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.jpg", path), SHOWN)


@pytest.mark.parametrize("scale", [(0.5, 0.5), (2, 2), (0.25, 0.25)])
def test_a_mask_of_another_size_and_the_same_shape_is_resampled(tmp_path: Path, scale: tuple[float, float]) -> None:
    path = photograph(tmp_path)
    for white in (255, 1):
        small = Image.fromarray(SHOWN.astype(np.uint8) * np.uint8(white))
        small.resize((int(WIDTH * scale[0]), int(HEIGHT * scale[1])), Image.Resampling.NEAREST).save(tmp_path / "m.png")
        np.testing.assert_array_equal(read_mask(tmp_path / "m.png", path), SHOWN)


@pytest.mark.parametrize("size", [(32, 48), (48, 33), (24, 17)])
def test_a_mask_of_another_shape_is_refused_in_one_line(tmp_path: Path, size: tuple[int, int]) -> None:
    Image.new("L", size).save(tmp_path / "m.png")
    with pytest.raises(UserError, match=rf"m\.png: the mask is of another size .*48x32, found {size[0]}x{size[1]}"):
        PictureLoader(photograph(tmp_path), SIZE, SIZE, tmp_path / "m.png").pixels()


@pytest.mark.parametrize("scale", [1, 2])
@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_masks_follow_a_turned_photograph(tmp_path: Path, orientation: int, scale: int) -> None:
    """Drawn on the picture as stored, without or with its EXIF, or upright: wherever the photograph is used, it fits."""
    path = photograph(tmp_path, orientation=orientation)
    stored = Image.fromarray(WHITE)
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored.resize((WIDTH * scale, HEIGHT * scale), Image.Resampling.NEAREST).save(tmp_path / "stored.png")
    stored.save(tmp_path / "with_exif.png", exif=exif)
    upright = read_mask(tmp_path / "with_exif.png", path)
    rows = SHOWN.any(axis=0)[:: 1 if orientation in (5, 6) else -1]
    assert upright.shape == (WIDTH, HEIGHT) and np.array_equal(upright.any(axis=1), rows)
    Image.fromarray((upright * 255).astype(np.uint8)).save(tmp_path / "upright.png")
    for name in ("stored.png", "with_exif.png", "upright.png"):
        np.testing.assert_array_equal(read_mask(tmp_path / name, path), upright)
        np.testing.assert_array_equal(read_mask(tmp_path / name, path, as_stored=True), SHOWN)
    load = PictureLoader(path, SIZE[::-1], SIZE[::-1], tmp_path / "stored.png")
    np.testing.assert_array_equal(load()[..., 3], upright)


def masked(scene: Scene, folder: Path, masks: Sequence[np.ndarray]) -> Scene:
    """A scene of opaque pictures with these masks."""
    photographs = []
    for i, (one, mask) in enumerate(zip(scene.splits["train"], masks, strict=False)):
        size = one.camera.width, one.camera.height
        Image.new("RGB", size, (200, 100, 50)).save(folder / f"p{i}.png")
        Image.fromarray(mask).resize(size).save(folder / f"m{i}.png")
        load = PictureLoader(folder / f"p{i}.png", size, size, folder / f"m{i}.png")
        photographs.append(Photograph(f"p{i}.png", one.camera, load))
    return dataclasses.replace(scene, splits={"train": tuple(photographs)}, notes={"masks": True})


def notices(caught: list[warnings.WarningMessage]) -> list[str]:
    return [str(each.message) for each in caught if each.category is Notice]


SQUARE = np.zeros((16, 16), np.uint8)
SQUARE[4:12, 4:12] = 255


def test_masks_that_hide_or_show_everything_are_said_once(procedural_scene: Scene, tmp_path: Path) -> None:
    scene = masked(procedural_scene, tmp_path, [SQUARE, SQUARE * 0, SQUARE | 255, SQUARE, SQUARE * 0])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_pixels(scene.splits["train"])
    assert notices(caught) == [
        "2 of 5 masks hide everything (p1.png, p4.png)",
        "1 of 5 masks shows everything (p2.png)",
    ]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_pixels(masked(procedural_scene, tmp_path, [SQUARE] * 3).splits["train"])
    assert not notices(caught)


@pytest.mark.filterwarnings("ignore::console.Notice")
def test_masks_that_all_hide_everything_end_the_work(procedural_scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nothing to see: all masks hide everything"):
        make_dataset(masked(procedural_scene, tmp_path, [SQUARE * 0] * 3))


class Bar:
    total = 0.0

    def update(self, done: float) -> None: ...


def test_bare_photographs_say_it_before_poses_are_looked_for(tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    (bare / "masks").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for i in range(4):
        Image.fromarray(rng.integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)).save(bare / f"{i}.png")
        Image.fromarray(WHITE if i < 3 else WHITE * 0).save(bare / "masks" / f"{i}.png")
    source = find_source(bare)
    assert source is not None
    (tmp_path / "work").mkdir()
    with pytest.warns(Notice, match=r"masks: 1 of 4 masks hides everything \(masks/3\.png\)"):
        prepare(source, tmp_path / "work", 10, Bar())  # type: ignore[arg-type]
    for i in range(3):
        Image.fromarray(WHITE * 0).save(bare / "masks" / f"{i}.png")
    with pytest.raises(UserError, match="all masks hide everything"):
        prepare(source, tmp_path / "work", 10, Bar())  # type: ignore[arg-type]
