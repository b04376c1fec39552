"""Photographs of every format become the same pictures: also of 16 bits, of floats, turned by EXIF; or are refused by name."""

import io
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest
import tifffile
from PIL import Image, ImageOps, features

from console import UserError
from training.posing.photograph import link_or_convert, read_photograph
from training.scenes.picture_headers import SCAN, read_header, short_reason
from training.scenes.pictures import PictureLoader, as_floats, decoded, read_mask, small_picture, with_alpha

COLOURS = np.random.default_rng(0).random((20, 30, 4)).astype(np.float32)
RGBA16 = np.rint(COLOURS * 65535).astype(np.uint16)
RGBA8 = np.rint(COLOURS * 255).astype(np.uint8)


def read_picture(path: Path) -> np.ndarray:
    """A picture as float32 [H, W, 4]."""
    return with_alpha(as_floats(decoded(path)))


def write_tiff(path: Path, values: np.ndarray, photometric: int = 2, extra: int | None = None, **more: Any) -> Path:
    """A TIFF of one uncompressed strip. photometric, extra: what its tags 262 and 338 say."""
    samples = [] if extra is None else [extra]
    tifffile.imwrite(path, values, photometric=photometric, extrasamples=samples, metadata=None, **more)
    return path


def write(path: Path, data: bytes | bytearray) -> Path:
    path.write_bytes(data)
    return path


def write_exr(path: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, **header}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
    return path


def premultiplied_light(dtype: type) -> dict[str, np.ndarray]:
    light = np.where(COLOURS <= 0.04045, COLOURS / 12.92, ((COLOURS + 0.055) / 1.055) ** 2.4)
    each = {c: (light[..., i] * COLOURS[..., 3]).astype(dtype) for i, c in enumerate("RGB")}
    return {**each, "A": COLOURS[..., 3].astype(dtype)}


def straight(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values[..., :3] * values[..., 3:], values[..., 3:]], axis=-1)


DEEP = {
    "float": lambda p: write_tiff(p / "a.tif", COLOURS, extra=2),
    "double": lambda p: write_tiff(p / "a.tif", COLOURS.astype(np.float64), extra=2),
    "half": lambda p: write_tiff(p / "a.tif", COLOURS.astype(np.float16), extra=2),
    "uint16": lambda p: write_tiff(p / "a.tiff", RGBA16, extra=2),
    "uint32": lambda p: write_tiff(p / "a.tif", np.rint(COLOURS * (2.0**32 - 1)).astype(np.uint32), extra=2),
    "premultiplied": lambda p: write_tiff(p / "a.tif", straight(COLOURS), extra=1),
    "png": lambda p: write(p / "a.png", imagecodecs.png_encode(RGBA16)),
    "jxl": lambda p: write(p / "a.jxl", imagecodecs.jpegxl_encode(RGBA16, lossless=True)),
    "j2k": lambda p: write(p / "a.j2k", imagecodecs.jpeg2k_encode(RGBA16, level=0, codecformat="j2k")),
    "exr float": lambda p: write_exr(p / "a.exr", premultiplied_light(np.float32)),
    "exr half": lambda p: write_exr(p / "a.exr", premultiplied_light(np.float16)),
}  # fmt: skip


@pytest.mark.parametrize("kind", DEEP)
def test_pictures_of_more_than_8_bits_keep_their_values_posed_and_bare(tmp_path: Path, kind: str) -> None:
    path = DEEP[kind](tmp_path)
    tolerance = 2e-3 if "half" in kind else 2e-5
    assert read_header(path).size == (30, 20) and read_header(path).transparent
    found = read_picture(path)
    np.testing.assert_allclose(straight(found), straight(COLOURS), atol=tolerance)
    loaded = PictureLoader(path, (30, 20), (30, 20)).pixels()
    most = 1 if "half" in kind or "exr" in kind else 0
    assert np.abs(loaded.astype(int) - RGBA8)[COLOURS[..., 3] > 0.05].max() <= most
    read = read_photograph(path)
    (tmp_path / "out").mkdir()
    bare = np.asarray(Image.open(tmp_path / "out" / link_or_convert(read, tmp_path / "out", "b")))
    assert read.needs_conversion and np.array_equal(bare, loaded)
    assert small_picture(path, 15, "RGB").size == (15, 10)


def test_of_an_openexr_the_main_layer_is_read_within_the_display_window(tmp_path: Path) -> None:
    layers = {f"beauty.{c}": values for c, values in premultiplied_light(np.float32).items()}
    layers |= {f"diffuse.{c}": np.ones((20, 30), np.float32) for c in "RGB"}
    window = (np.array([-2, 3], np.int32), np.array([24, 29], np.int32))
    found = read_picture(write_exr(tmp_path / "a.exr", layers, displayWindow=window))
    assert found.shape == (27, 27, 4) and not found[:, :2].any() and not found[17:].any()
    np.testing.assert_allclose(straight(found[:17, 2:]), straight(COLOURS[3:, :25]), atol=2e-5)
    light = {c: np.full((20, 30), 0.5, np.float32) for c in "RGB"}
    opaque = read_picture(write_exr(tmp_path / "b.exr", light, displayWindow=window))[..., 3]
    assert opaque[:17, 2:].all() and opaque.sum() == 17 * 25
    with pytest.raises(UserError, match=r"no channels that are a picture .*found Z"):
        read_picture(write_exr(tmp_path / "z.exr", {"Z": np.ones((20, 30), np.float32)}))


def test_radiance_hdr_is_linear_light(tmp_path: Path) -> None:
    channels = premultiplied_light(np.float32)
    light = np.stack([channels[c] for c in "RGB"], axis=-1)
    assert oiio.ImageBuf(light).write(str(tmp_path / "a.hdr"))
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(read_picture(tmp_path / "a.hdr")[..., :3], shown, atol=0.05)  # 8 bits, of the brightest


def test_white_is_zero_in_some_tiffs_and_floats_brighter_than_white_are_refused(tmp_path: Path) -> None:
    grey = np.rint(COLOURS[..., 0] * 65535).astype(np.uint16)
    found = read_picture(write_tiff(tmp_path / "a.tif", grey, photometric=0))
    np.testing.assert_allclose(found[..., :3], np.repeat(1 - COLOURS[..., :1], 3, -1), atol=2e-5)
    with pytest.raises(UserError, match="raw photographs are not read"):
        read_picture(write_tiff(tmp_path / "a.tif", grey, photometric=32803))
    with pytest.raises(UserError, match=r"no display-referred colours .*found up to 1.9"):
        read_picture(write_tiff(tmp_path / "a.tif", 2 * COLOURS[..., :3]))


@pytest.mark.parametrize("suffix", ["png", "jpg", "webp", "tif", "avif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_upright_as_exif_says_or_as_stored(tmp_path: Path, suffix: str, orientation: int) -> None:
    if suffix == "avif" and not features.check("avif"):
        pytest.skip("this Pillow has no AVIF")
    blocks = Image.fromarray(np.kron(RGBA8[:3, :5, :3], np.ones((16, 16, 1), np.uint8)))
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a.{suffix}"
    options: Any = {"quality": 98} if suffix in ("jpg", "avif") else {}
    blocks.save(path, exif=exif, **options)
    with Image.open(path) as image:
        upright = np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    assert np.array_equal(decoded(path), upright)
    assert read_header(path).size == upright.shape[1::-1] and read_header(path).stored == (80, 48)
    assert (read_header(path).orientation != 1) == (orientation != 1)
    stored = PictureLoader(path, (80, 48), (80, 48), as_stored=True)()
    most = 1e-6 if suffix in ("png", "tif") else 0.15
    np.testing.assert_allclose(stored[8::16, 8::16, :3], RGBA8[:3, :5, :3] / 255, rtol=0, atol=most)
    for as_stored, whole in ((False, upright), (True, decoded(path, as_stored=True))):
        small = np.asarray(small_picture(path, 80, "RGB", as_stored=as_stored))
        assert small.shape == whole.shape and np.abs(small.astype(int) - whole).max() <= 2


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("a.dng", "DNG pictures are not read .*export them as JPEG"),
        ("a.NEF", "NEF pictures are not read"),
        ("a.gif", "GIF pictures are not read .*convert them to JPEG or PNG"),
        ("a.psd", "PSD pictures are not read"),
    ],
)
def test_formats_that_are_not_read_are_refused_by_name(tmp_path: Path, name: str, said: str) -> None:
    # what many of them are: a TIFF, whose first picture is a preview
    write_tiff(tmp_path / name, RGBA8[..., :3], subfiletype=1)
    with pytest.raises(UserError, match=said):
        read_header(tmp_path / name)


@pytest.mark.parametrize("kind", ["tif", "exr"])
def test_a_header_that_claims_more_than_its_bytes_hold_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    if kind == "tif":
        path = write_tiff(tmp_path / "a.tif", COLOURS, extra=2)
        data = bytearray(path.read_bytes())
        data[18:22] = data[30:34] = struct.pack("<I", 1 << 19)  # its width and height
    else:
        path = write_exr(tmp_path / "a.exr", premultiplied_light(np.float32))
        data = bytearray(path.read_bytes())
        for window in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
            at = data.index(window) + len(window) + 4 + 8
            data[at : at + 8] = struct.pack("<ii", (1 << 19) - 1, (1 << 19) - 1)
    path.write_bytes(data)
    with pytest.raises(UserError, match=r"its header claims 524288x524288 pixels|image size 4194304\.0 MB exceeds"):
        read_picture(path)
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(UserError, match=r"a\.(tif|exr): "):
        read_picture(path)


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
    everywhere = np.broadcast_to(np.array(colour, np.uint8), (HEIGHT, WIDTH, len(colour)))
    return Image.fromarray(np.dstack([everywhere, alpha]))


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
    "coloured objects": lambda: Image.fromarray((PHOTO // 2 + np.array([0, 40, 0], np.uint8)) * SHOWN[..., None]),
}  # fmt: skip


def photograph(folder: Path) -> Path:
    Image.new("RGB", SIZE, (200, 100, 50)).save(folder / "a.jpg")
    return folder / "a.jpg"


@pytest.mark.parametrize("kind", MASKS)
def test_masks_of_any_kind_show_the_same_posed_and_bare(tmp_path: Path, kind: str) -> None:
    path, mask = photograph(tmp_path), tmp_path / "mask.png"
    MASKS[kind]().save(mask)
    load = PictureLoader(path, SIZE, SIZE, mask)
    np.testing.assert_array_equal(load()[..., 3], SHOWN)
    np.testing.assert_array_equal(load.pixels()[..., 3], WHITE)
    np.testing.assert_array_equal(np.asarray(load.thumbnail(WIDTH))[..., 3], WHITE)


@pytest.mark.parametrize("scale", [0.5, 2, 0.25])
def test_a_mask_of_another_size_and_the_same_shape_is_resampled(tmp_path: Path, scale: float) -> None:
    path = photograph(tmp_path)
    for white in (255, 1):
        small = Image.fromarray(SHOWN.astype(np.uint8) * np.uint8(white))
        small.resize((int(WIDTH * scale), int(HEIGHT * scale)), Image.Resampling.NEAREST).save(tmp_path / "m.png")
        np.testing.assert_array_equal(read_mask(tmp_path / "m.png", path), SHOWN)


@pytest.mark.parametrize("size", [(32, 48), (48, 33), (24, 17)])
def test_a_mask_of_another_shape_is_refused_in_one_line(tmp_path: Path, size: tuple[int, int]) -> None:
    Image.new("L", size).save(tmp_path / "m.png")
    with pytest.raises(UserError, match=rf"m\.png: the mask is of another size .*48x32, found {size[0]}x{size[1]}"):
        PictureLoader(photograph(tmp_path), SIZE, SIZE, tmp_path / "m.png").pixels()


# What lies under the name of a photograph is opened as a picture or not at all. (That no other program is started for it:
# tests/fuzz/findings.jsonl.)


@pytest.mark.parametrize(
    ("kind", "mode"), [("PNG", "L"), ("PNG", "P"), *((k, "RGB") for k in ("JPEG", "WEBP", "TIFF", "BMP"))]
)
def test_a_picture_of_any_mode_or_another_format_than_its_name_says_opens(tmp_path: Path, kind: str, mode: str) -> None:
    Image.new("RGB", (6, 4), (200, 100, 50)).convert(mode).save(tmp_path / "003.png", format=kind)
    assert read_picture(tmp_path / "003.png").shape == (4, 6, 4)


@pytest.mark.parametrize(
    "data, found",
    [
        (b"GIF89a\1\0\1\0\0\0\0;", "found a GIF"),
        (b"%PDF-1.7\n", "found a PDF"),
        (b"<html>\n<body>not found", "found text that begins '<html> <body>not found'"),
        (b"", "found an empty file"),
        (bytes(range(128, 160)), "found unknown data"),
    ],
)
def test_what_is_no_picture_is_told_for_what_it_is(tmp_path: Path, data: bytes, found: str) -> None:
    (tmp_path / "003.png").write_bytes(data)
    with pytest.raises(UserError) as raised:
        read_picture(tmp_path / "003.png")
    line = str(raised.value)
    assert "003.png" in line and "expected PNG, JPEG, WebP, TIFF, BMP, AVIF, HEIC, JPEG XL" in line and found in line


def progressive(more: int) -> bytes:
    """A progressive JPEG that goes over its pixels so many times more than it has to, 31 bytes each time."""
    file = io.BytesIO()
    Image.new("RGB", (64, 48), (200, 100, 50)).save(file, "JPEG", progressive=True)
    whole, end = file.getvalue()[:-2], file.getvalue()[-2:]
    return whole + whole[whole.rindex(SCAN) :] * more + end


def test_a_jpeg_of_many_scans_is_refused_by_all_that_decodes(tmp_path: Path) -> None:
    picture = tmp_path / "r_0.png"
    picture.write_bytes(progressive(200))
    load = PictureLoader(picture, (64, 48), (64, 48))
    for decode in (lambda: read_picture(picture), load, load.pixels, lambda: load.thumbnail(8)):
        with pytest.raises(UserError, match=r"r_0\.png: the picture cannot be decoded.*it has 2\d\d scans"):
            decode()
    picture.write_bytes(progressive(50))
    np.testing.assert_allclose(read_picture(picture)[..., 0], 200 / 255, atol=0.02)


def test_a_complaint_of_the_system_comes_without_its_number_and_path():
    assert short_reason(PermissionError(13, "Permission denied", "a.jpg")) == "Permission denied"
