"""Which pictures of a view are asked for, and their files: PNG (8 bit, straight alpha) and OpenEXR (float32, premultiplied).

One view may be shown in several modes. As PNG each mode is a file of its own; one OpenEXR file holds all of them as channels.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import OpenImageIO as oiio
from PIL import Image

from console import UserError
from console.atomic import replacing
from scenepack.pack import Pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.layers import depth_along_axis, linear_rgb, straight_rgba, unit_normals
from viewer.rendering.renderer import MODES_OVER_BACKGROUND
from viewer.rendering.settings import MODES, Mode, RenderSettings

PICTURE = "rgb"  # what the mode `normal` is called in lists and file names
COUNTED = ("samples", "jumps")  # modes whose numbers come from RenderSettings.counts, in this order
EXR, PNG = ".exr", ".png"
DEPTH_MEANS = "z-depth: distance along the optical axis, in units of the grid frame; 0 where there is nothing"
DISTANCE_MEANS = "distance from the camera, in units of the grid frame; 0 where there is nothing"
NORMALS_MEAN = "unit vectors in the grid frame (y up), away from the surface; 0 where there is nothing"


@dataclass(frozen=True)
class Pass:
    """One drawing of a view. name: of the mode, rgb for the picture. floats: four float32 a pixel, else RGB of 8 bits."""

    name: str
    settings: RenderSettings
    floats: bool


def parse_modes(text: str) -> tuple[Mode, ...]:
    """Display modes named with commas between; rgb is the picture, and beside it `normal` is normals. UserError for others."""
    words = [word.strip() for word in text.split(",")]
    if PICTURE in words:
        words = ["normals" if word == "normal" else word for word in words]
    modes = ["normal" if word == PICTURE else word for word in words]
    for mode, word in zip(modes, words, strict=True):
        if mode not in MODES:
            expected = ", ".join((PICTURE, *MODES[1:]))
            raise UserError("is no display mode", where="--mode", expected=expected, found=repr(word))
    if len(set(modes)) < len(modes):
        raise UserError("names a mode twice", where="--mode", found=repr(text))
    return cast("tuple[Mode, ...]", tuple(modes))


def passes_for(
    modes: Sequence[Mode], settings: RenderSettings, *, transparent: bool = False, exr: bool = False
) -> list[Pass]:
    """What must be drawn. settings: all else that counts; exr: for an OpenEXR file.

    transparent: without the background, whose colour still goes into the view MLP. An OpenEXR file that holds opacity holds
    colours without background as well, as the format means it.
    """
    transparent = transparent or (exr and "alpha" in modes)
    passes = []
    for mode in modes:
        of_mode, name = replace(settings, mode=mode), PICTURE if mode == "normal" else mode
        over = mode in MODES_OVER_BACKGROUND
        if exr and mode in COUNTED:
            passes.append(Pass(name, replace(of_mode, counts=True, samples=1), True))
        elif (transparent and over) or (exr and not over):
            passes.append(Pass(name, replace(of_mode, raw=True), True))
        else:
            passes.append(Pass(name, of_mode, exr))
    return passes


def write_pngs(path: Path, passes: Sequence[Pass], pictures: Sequence[np.ndarray]) -> list[Path]:
    """Writes pictures, uint8 [h, w, 3] or raw (rendering.layers): one to `path`, several as NAME_MODE.png. Returns the files."""
    written = []
    for each, pixels in zip(passes, pictures, strict=True):
        file = path if len(passes) == 1 else path.with_name(f"{path.stem}_{each.name}{path.suffix or PNG}")
        with replacing(file) as new:
            picture = straight_rgba(pixels) if pixels.dtype == np.float32 else pixels
            Image.fromarray(picture).save(new, format="PNG")
        written.append(file)
    return written


def write_exr(
    file: Path, passes: Sequence[Pass], pictures: Sequence[np.ndarray], camera: ViewCamera, pack: Pack
) -> None:
    """Writes what was drawn into one OpenEXR file, float32, ZIP.

    Channels: R, G, B (linear light, times opacity), A, Z, N.X, N.Y, N.Z; other modes as MODE.R, MODE.G, MODE.B, and the costs as
    `samples` and `jumps`. The header's `snerg` says what they mean, with the camera, as JSON.
    """
    channels = {
        name: values
        for each, pixels in zip(passes, pictures, strict=True)
        for name, values in exr_channels(each, pixels, camera, pack).items()
    }
    picture = np.stack(list(channels.values()), axis=-1, dtype=np.float32)
    header = oiio.ImageSpec(picture.shape[1], picture.shape[0], len(channels), oiio.FLOAT)
    header.channelnames = tuple(channels)
    header.attribute("compression", "zip")
    header.attribute("snerg", json.dumps(_said(passes, camera)))
    row_vectors = np.linalg.inv(camera.grid_T_camera).T  # OpenEXR's matrices act on these
    header.attribute("worldtocamera", oiio.TypeMatrix, tuple(map(float, row_vectors.ravel())))
    with replacing(file) as new:
        output = oiio.ImageOutput.create("openexr")
        if output is None or not (output.open(str(new), header) and output.write_image(picture) and output.close()):
            raise OSError(f"{new}: {output.geterror() if output else oiio.geterror()}")


def exr_channels(each: Pass, pixels: np.ndarray, camera: ViewCamera, pack: Pack) -> Mapping[str, np.ndarray]:
    """Channels [h, w] by name of one pass; pixels: float32 [h, w, 4]."""
    if each.name in COUNTED:
        return {each.name: pixels[..., COUNTED.index(each.name)]}
    if each.name == "alpha":
        return {"A": pixels[..., 3]}
    if each.name == "depth":
        return {"Z": depth_along_axis(pixels, camera, pack)}
    if each.name == "normals":
        normals = unit_normals(pixels)
        return {f"N.{axis}": normals[..., i] for i, axis in enumerate("XYZ")}
    values = linear_rgb(pixels) if each.name in (PICTURE, "diffuse") else pixels[..., :3]
    prefix = "" if each.name == PICTURE else f"{each.name}."
    channels = {f"{prefix}{name}": values[..., i] for i, name in enumerate("RGB")}
    return channels | ({"A": pixels[..., 3]} if each.name == PICTURE and each.settings.raw else {})


def _said(passes: Sequence[Pass], camera: ViewCamera) -> dict[str, object]:
    said: dict[str, object] = {
        "grid_T_camera": camera.grid_T_camera.tolist(),
        **{name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy")},
    }
    names = {each.name for each in passes}
    said |= {"Z": DISTANCE_MEANS if camera.is_panorama else DEPTH_MEANS} if "depth" in names else {}
    said |= {"N": NORMALS_MEAN} if "normals" in names else {}
    if PICTURE in names:
        background = next(each.settings for each in passes if each.name == PICTURE)
        over = "without background, times A" if background.raw else f"over the background {list(background.background)}"
        said["RGB"] = f"linear light, decoded from sRGB; {over}"
    return said
