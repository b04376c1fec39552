"""Colours of films: HLG, PQ and wide gamuts come as sRGB, and films without tags as players show them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.training.posing.rooms import texture
from tests.training.posing.test_films import taken

av = pytest.importorskip("av", reason="films need PyAV (the extra video)")

from training.posing import film as films  # noqa: E402
from training.posing.film import HLG, PQ, SRGB_T_BT2020, SRGB_T_P3, srgb_to_linear  # noqa: E402

BT709, BT2020 = 1, 9  # matrices, as ITU-T H.273 numbers them
UNSPECIFIED, LIMITED = 2, 1
P3 = 12
SIZE = (96, 64)


def picture() -> np.ndarray:
    """Coloured mid-tones and a grey ramp up to white: uint8 [H, W, 3]."""
    values = texture(5)[: SIZE[1], : SIZE[0]] * 0.75 + 20
    values[:, :, 0] += 20 * np.sin(np.arange(SIZE[0]) / 9)
    values[:, :, 2] -= 25
    values[-16:] = np.linspace(0, 255, SIZE[0])[:, None]
    return np.clip(values, 0, 255).astype(np.uint8)


def hlg_oetf(light: np.ndarray) -> np.ndarray:
    """BT.2100, table 5; light of the scene in [0, 1]."""
    logarithm = 0.17883277 * np.log(np.maximum(12 * light - 0.28466892, 1e-9)) + 0.55991073
    return np.where(light <= 1 / 12, np.sqrt(3 * np.maximum(light, 0)), logarithm)


def pq_inverse_eotf(nits: np.ndarray) -> np.ndarray:
    """BT.2100, table 4."""
    power = np.clip(nits / 10000, 0, 1) ** (2610 / 16384)
    return ((0.8359375 + 18.8515625 * power) / (1 + 18.6875 * power)) ** 78.84375


def write_film(
    file: Path, signal: np.ndarray, codec: str, pix_fmt: str, matrix: int, tags: dict[str, int], options: dict[str, str]
) -> Path:
    """Three frames of a signal, float [H, W, 3] in [0, 1], coded by a matrix and tagged as `tags` say."""
    coded = np.rint(np.clip(signal, 0, 1) * 65535).astype(np.uint16)
    with av.open(str(file), "w", format="matroska" if file.suffix == ".mkv" else "mov") as film:
        stream = film.add_stream(codec, rate=10, options=options)
        stream.height, stream.width = coded.shape[:2]
        stream.pix_fmt = pix_fmt
        for i in range(3):
            frame = av.VideoFrame.from_ndarray(coded, format="rgb48le").reformat(
                format=pix_fmt, dst_colorspace=matrix, dst_color_range=tags["color_range"] or LIMITED
            )
            for target in (stream.codec_context, frame):
                for name, value in tags.items():
                    setattr(target, name, value)
            frame.pts = i
            film.mux(stream.encode(frame))
        film.mux(stream.encode())
    return file


def tags(matrix: int, color_range: int, transfer: int = UNSPECIFIED, primaries: int = UNSPECIFIED) -> dict[str, int]:
    return {"colorspace": matrix, "color_range": color_range, "color_trc": transfer, "color_primaries": primaries}


def saturation(values: np.ndarray) -> float:
    return float((values.max(axis=-1) - values.min(axis=-1)).mean())


TEN_BITS: list[tuple[int, str, str, str, dict[str, Any]]] = [
    (PQ, "film.mkv", "ffv1", "yuv444p10le", {}),
    (HLG, "film.mkv", "ffv1", "yuv444p10le", {}),
    (HLG, "film.mov", "libx265", "yuv420p10le", {"crf": "4", "x265-params": "log-level=none"}),
    (PQ, "film.mov", "prores_ks", "yuv422p10le", {}),
]


@pytest.mark.parametrize(("transfer", "name", "codec", "pix_fmt", "options"), TEN_BITS)
def test_an_hdr_film_has_the_colours_of_its_picture(transfer, name, codec, pix_fmt, options, tmp_path):
    shown = picture()
    light = srgb_to_linear(shown / 255.0) @ np.linalg.inv(SRGB_T_BT2020).T
    white = float(films.hlg_to_scene(np.array(films.DIFFUSE_WHITE_HLG)))
    signal = hlg_oetf(light * white) if transfer == HLG else pq_inverse_eotf(light * films.DIFFUSE_WHITE_PQ)
    film = write_film(tmp_path / name, signal, codec, pix_fmt, BT2020, tags(BT2020, LIMITED, transfer, BT2020), options)
    found = taken(film, 1)[0][1].astype(float)
    middle = (shown.max(axis=-1) < 255 * 0.9) & (shown.min(axis=-1) > 8)
    assert middle.mean() > 0.8 and saturation(shown) > 25
    assert saturation(found) == pytest.approx(saturation(shown), rel=0.1)
    assert np.abs(found.mean(axis=(0, 1)) - shown.mean(axis=(0, 1))).max() < 3
    assert np.abs(found - shown)[middle].mean() < 0.02 * 255
    ramp = found[-8, :, 1]
    assert 236 < ramp[-2] < 252 and (np.diff(ramp[::8]) > 0).all()  # nothing is clipped


@pytest.mark.parametrize(("primaries", "matrix"), [(BT2020, SRGB_T_BT2020), (P3, SRGB_T_P3)])
def test_wide_gamuts_become_srgb(primaries: int, matrix: np.ndarray, tmp_path: Path):
    shown = picture()
    light = srgb_to_linear(shown / 255.0) @ np.linalg.inv(matrix).T
    signal = np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)
    said = tags(BT709, LIMITED, 1, primaries)
    film = write_film(tmp_path / "film.mkv", signal, "ffv1", "yuv444p10le", BT709, said, {})
    found = taken(film, 1)[0][1].astype(float)
    assert np.abs(found - shown).mean() < 0.012 * 255
    assert saturation(found) == pytest.approx(saturation(shown), rel=0.06)
