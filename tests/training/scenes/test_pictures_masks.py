"""A mask shows the same whatever program wrote it: alpha, 0 and 1, palettes, other sizes, or turned with its photograph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from console import UserError
from training.scenes.pictures import PictureLoader, read_mask

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
