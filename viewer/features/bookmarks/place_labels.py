"""Annotated places in saved pictures and films: a number at each place that is seen, and its title beside it."""

import importlib.util
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from console.streams import one_line
from scenepack.pack import Pack
from viewer.core.annotations import Annotations
from viewer.core.pose import project
from viewer.features.bookmarks.bookmarks import is_covered
from viewer.rendering.camera import ViewCamera
from viewer.rendering.settings import RenderSettings

SIDE, LEAST = 0.045, 16.0  # a disc's diameter, of the picture's lesser side; pixels
SMOOTH = 4  # labels are drawn so many times larger
DISC, CHIP, RIM, TEXT = (26, 33, 44, 255), (13, 17, 23, 225), (69, 208, 189, 255), (230, 235, 242, 255)
WIDEST = 0.4  # a title, of the picture's width


def with_places(
    picture: np.ndarray, camera: ViewCamera, pack: Pack, settings: RenderSettings, annotations: Annotations
) -> np.ndarray:
    """The picture of a camera, uint8 [h, w, 3], with the places that nothing covers."""
    marked = [(i, view) for i, view in enumerate(annotations.bookmarks, 1) if view.point is not None]
    if not marked:
        return picture
    pixels, ahead = project(camera, np.array([view.point for _, view in marked]))
    height, width = picture.shape[:2]
    size = round(max(SIDE * min(height, width), LEAST))
    image = Image.fromarray(picture)
    for (number, view), (x, y), before in zip(marked, pixels, ahead, strict=True):
        assert view.point is not None
        if not before or not (0 <= x < width and 0 <= y < height) or is_covered(pack, camera, settings, view.point):
            continue
        label = _label(number, one_line(view.name, 60), size, round(WIDEST * width), left=bool(x > 0.6 * width))
        corner = round(x - label.width + 0.5 * size) if x > 0.6 * width else round(x - 0.5 * size)
        image.paste(label, (corner, round(y - 0.5 * size)), label)
    return np.asarray(image)


@lru_cache(maxsize=256)
def _label(number: int, title: str, size: int, widest: int, *, left: bool) -> Image.Image:
    """A disc of `size` pixels with a number, and a title at its right, or at its left."""
    big, font = SMOOTH * size, _font(round(0.56 * SMOOTH * size), title)
    while title and font.getlength(title) > SMOOTH * widest:
        title = title[:-2].rstrip() + "…" if len(title) > 2 else ""
    wide = big + (round(font.getlength(title) + 0.75 * big) if title else 0)
    image = Image.new("RGBA", (wide, big), (0, 0, 0, 0))
    draw = ImageDraw.Draw(image)
    disc = wide - big if left else 0
    if title:
        draw.rounded_rectangle((0, 0.06 * big, wide - 1, 0.94 * big), 0.44 * big, CHIP)
        start = 0.4 * big if left else 1.25 * big
        draw.text((start, 0.5 * big), title, TEXT, font, "lm")
    draw.ellipse((disc, 0, disc + big - 1, big - 1), RIM)
    rim = 0.07 * big
    draw.ellipse((disc + rim, rim, disc + big - 1 - rim, big - 1 - rim), DISC)
    draw.text((disc + 0.5 * big, 0.5 * big), str(number), TEXT, _font(round(0.56 * big), str(number)), "mm")
    return image.resize((max(wide // SMOOTH, 1), size), Image.Resampling.BOX)


@lru_cache(maxsize=64)
def _font(size: int, text: str) -> ImageFont.FreeTypeFont:
    """The interface's font, or one of the system's where that lacks letters of the text."""
    spec = importlib.util.find_spec("imgui_bundle")
    assert spec is not None and spec.origin is not None
    own = ImageFont.truetype(str(Path(spec.origin).parent / "assets" / "fonts" / "Roboto" / "Roboto-Regular.ttf"), size)
    missing = "".join(sorted({letter for letter in text if _is_box(own, letter)}))
    if missing:
        from viewer.core.theme import load_fonts

        for found in load_fonts(missing):
            other = ImageFont.truetype(str(found.path), size, found.number)
            if not any(_is_box(other, letter) for letter in text):
                return other
    return own


def _is_box(font: ImageFont.FreeTypeFont, letter: str) -> bool:
    """Whether a font draws a letter as it draws those it does not have."""
    drawn, box = (bytes(font.getmask(each)) for each in (letter, "\U0010ffff"))  # pyright: ignore[reportArgumentType]
    return not letter.isspace() and drawn == box
