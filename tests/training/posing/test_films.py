"""Films as photographs: the sharpest frame of each interval, upright, in sRGB; and what is no film is refused."""

import io
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageFilter

from console import collect_notices
from tests.training.posing.rooms import texture
from training.posing.child_process import ask
from training.scenes.sources import require_source

av = pytest.importorskip("av", reason="films need PyAV (the extra video)")

from training.posing import film as films  # noqa: E402
from training.posing.film import BT709, BT2020, HLG, P3, PQ, SRGB_T_BT2020, SRGB_T_P3, srgb_to_linear  # noqa: E402

WIDTH, HEIGHT = 192, 128
# Matrices of ISO/IEC 14496-12, as phones write them, by how often a picture is to be turned clockwise by 90°.
TURNS = {
    turns: np.array([c << 16, s << 16, 0, -s << 16, c << 16, 0, x << 16, y << 16, 1 << 30], ">i4")
    for turns, (c, s, x, y) in {1: (0, 1, HEIGHT, 0), 2: (-1, 0, WIDTH, HEIGHT), 3: (0, -1, 0, WIDTH)}.items()
}
# Suffix, FFmpeg's muxer, codec, and options of the muxer.
CONTAINERS = [
    (".mp4", "mp4", "libx264", {}), (".mov", "mov", "mpeg4", {}), (".webm", "webm", "libvpx", {}),
    (".mkv", "matroska", "ffv1", {}), (".avi", "avi", "mpeg4", {}), (".AVI", "avi", "mjpeg", {}),
    (".avi", "avi", "libx264", {}), (".ts", "mpegts", "libx264", {}),
    (".MTS", "mpegts", "mpeg2video", {"mpegts_m2ts_mode": "1"}), (".wmv", "asf", "wmv2", {}), (".asf", "asf", "msmpeg4", {}),
    (".flv", "flv", "flv", {}), (".3gp", "3gp", "mpeg4", {}), (".ogv", "ogg", "libvpx", {}), (".mpg", "mpeg", "mpeg1video", {}),
    (".vob", "vob", "mpeg2video", {}),
]  # fmt: skip


def frames_of_film(count: int = 24, sharp_every: int = 4) -> list[np.ndarray]:
    """A walk along a wall; between sharp frames, blurred ones. Its upper left corner is red. uint8 [HEIGHT, WIDTH, 3]."""
    wall = texture(3).astype(np.uint8)
    out = []
    for i in range(count):
        frame = wall[100 : 100 + HEIGHT, 10 * i : 10 * i + WIDTH].copy()
        frame[:40, :40] = 255, 0, 0
        picture = Image.fromarray(frame)
        if sharp_every > 1 and i % sharp_every != 2:
            picture = picture.filter(ImageFilter.GaussianBlur(3))
        out.append(np.array(picture))
    return out


def write_film(
    file: Path, frames: list[np.ndarray], times: list[int], matrix: np.ndarray | None = None, *, muxer: str = "mp4",
    options: dict[str, str] | None = None,
) -> Path:  # fmt: skip
    """A film whose frames are shown at `times` (milliseconds), with that display matrix in its header. options: of the muxer."""
    buffer = io.BytesIO()
    with av.open(buffer, "w", format=muxer, options=options or {}) as film:
        stream = film.add_stream("libx264", rate=1000, options={"crf": "12"})
        stream.bit_rate = 8_000_000
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.time_base = "yuv420p", Fraction(1, 1000)
        stream.codec_context.time_base = Fraction(1, 1000)
        for pixels, time in zip(frames, times, strict=True):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = time, Fraction(1, 1000)
            film.mux(stream.encode(frame))
        film.mux(stream.encode())
    data = bytearray(buffer.getvalue())
    if matrix is not None:
        at = data.index(b"tkhd") + 4 + 40  # after version, times, track, layer and volume (ISO/IEC 14496-12, 8.3.2)
        assert np.frombuffer(data, ">i4", 9, at)[0] == 1 << 16
        data[at : at + 36] = matrix.tobytes()
    file.write_bytes(data)
    return file


def taken(film: Path, most: int = 6) -> list[tuple[float, np.ndarray]]:
    folder = film.parent / "frames"
    folder.mkdir()
    frames = films.take_frames(film, folder, most, lambda *_: None)
    return [(f.seconds, np.asarray(Image.open(folder / f.name, formats=["JPEG"]).convert("RGB"))) for f in frames]


@pytest.mark.parametrize(("suffix", "muxer", "codec", "options"), CONTAINERS)
def test_films_of_every_container_give_the_same_frames(suffix, muxer, codec, options, tmp_path):
    frames, film = frames_of_film(sharp_every=1), tmp_path / f"walk{suffix}"
    with av.open(str(film), "w", format=muxer, options=options) as written:
        stream = written.add_stream(codec, rate=25, options={"crf": "10"} if codec == "libx264" else {})
        stream.width, stream.height = WIDTH, HEIGHT
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.bit_rate = 8_000_000
        for pixels in frames:
            written.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        written.mux(stream.encode())
    source = require_source(tmp_path)
    assert source.kind == "film" and source.files == (film,)
    with collect_notices() as said:
        found = taken(film, 4)
    assert not said and len(found) == 4 and found[0][0] < 0.3 and 0.5 < found[-1][0] < 1.1
    for _, picture in found:
        assert picture.shape == (HEIGHT, WIDTH, 3)
        assert min(np.abs(picture.astype(float) - frame).mean() for frame in frames) < 12
    counts: list[int] = []
    shown: list[float] = []
    films.glimpse(film, 4, 3, counts.append, lambda _, at, __: shown.append(at))
    assert counts == [4] and shown and shown == sorted(shown)


def test_a_glimpse_of_a_film_counts_its_frames_and_shows_some_of_them_in_their_order(tmp_path: Path):
    film = write_film(tmp_path / "walk.mp4", frames_of_film(), [100 * i for i in range(24)], matrix=TURNS[1])
    counts: list[int] = []
    shown: list[tuple[float, tuple[int, int]]] = []
    count, seconds = films.glimpse(film, 6, 8, counts.append, lambda _, at, picture: shown.append((at, picture.size)))
    assert counts == [count] == [6] and seconds > 0
    assert len(shown) == 8 and [at for at, _ in shown] == sorted({at for at, _ in shown}) and shown[-1][0] > 1.8
    assert {size for _, size in shown} == {(HEIGHT, WIDTH)}  # upright


@pytest.mark.parametrize(("muxer", "options"), [("matroska", {}), ("mp4", {"moov_size": "20000"})])
def test_a_film_that_was_cut_off_is_used_up_to_there_and_a_notice_says_so(muxer, options, tmp_path):
    film = write_film(tmp_path / "film", frames_of_film(), [100 * i for i in range(24)], muxer=muxer, options=options)
    film.write_bytes(film.read_bytes()[: film.stat().st_size // 3])
    request = {"film": str(film), "images": str(tmp_path), "most": 6}
    with collect_notices() as said:
        assert 1 <= len(ask("take_frames", request, tmp_path / "log.txt", lambda *_: None)) < 6
    (line,) = said
    assert re.search(r"film: the film ends early \(expected 2\.\d s, found 0\.\d s\); copy it again", line)


@pytest.mark.parametrize("turns", [0, *TURNS])
def test_the_sharpest_frame_of_each_interval_is_taken_and_comes_upright(turns: int, tmp_path: Path):
    """As a phone that is held upright or upside down turns them."""
    frames = frames_of_film()
    film = write_film(tmp_path / "walk.mp4", frames, [100 * i for i in range(24)], matrix=TURNS.get(turns))
    found = taken(film)
    assert [round(seconds * 10) for seconds, _ in found] == [2, 6, 10, 14, 18, 22]
    for seconds, picture in found:
        expected = np.rot90(frames[round(seconds * 10)], -turns).astype(float)  # clockwise
        assert picture.shape == expected.shape
        assert np.abs(picture - expected).mean() < 12


def test_frames_are_counted_by_their_time_and_a_camera_that_rests_gives_its_sharpest(tmp_path: Path):
    frames = frames_of_film(12, sharp_every=1)
    hazy = np.array(Image.fromarray(frames[-1]).filter(ImageFilter.GaussianBlur(0.7)))
    walking, resting = [100 * i for i in range(11)], [1100 + 500 * i for i in range(12)]
    film = write_film(tmp_path / "walk.mp4", [*frames[:11], *[hazy] * 6, frames[-1], *[hazy] * 5], walking + resting)
    found = taken(film, most=24)
    assert [round(seconds, 1) for seconds, _ in found][-1] == 4.1  # of all that rests, one
    assert [round(seconds, 1) for seconds, _ in found][-2] <= 1.0
    assert films.intervals_of([0.0, 0.1, 0.2, 5.0, 10.0], 2) == [0, 0, 0, 1, 1]
    assert films.intervals_of([3.0], 5) == [0] and max(films.intervals_of([0.0, 1.0], 100)) == 5


def test_a_camera_that_slows_down_leaves_most_frames_to_where_it_moves(tmp_path: Path):
    wall = texture(3).astype(np.uint8)
    places = [3 * i for i in range(30)] + [90 + 14 * i for i in range(10)]
    frames = [np.ascontiguousarray(wall[100 : 100 + HEIGHT, x : x + WIDTH]) for x in places]
    found = taken(write_film(tmp_path / "walk.mp4", frames, [100 * i for i in range(40)]), most=6)
    assert 4 <= len(found) <= 6 and len(list((tmp_path / "frames").iterdir())) == len(found)
    assert sum(seconds > 2.9 for seconds, _ in found) >= 3, "by their time alone, it would be one or two"


LIMITED = 1  # range of a signal, as ITU-T H.273 numbers it
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


def write_coded(
    file: Path, signal: np.ndarray, codec: str, pix_fmt: str, options: dict[str, str],
    *, matrix: int, transfer: int, primaries: int,
) -> Path:  # fmt: skip
    """Three frames of a signal, float [H, W, 3] in [0, 1], coded by that matrix and tagged as said."""
    coded = np.rint(np.clip(signal, 0, 1) * 65535).astype(np.uint16)
    tags = {"colorspace": matrix, "color_range": LIMITED, "color_trc": transfer, "color_primaries": primaries}
    with av.open(str(file), "w", format="matroska" if file.suffix == ".mkv" else "mov") as film:
        stream = film.add_stream(codec, rate=10, options=options)
        stream.height, stream.width = coded.shape[:2]
        stream.pix_fmt = pix_fmt
        for i in range(3):
            frame = av.VideoFrame.from_ndarray(coded, format="rgb48le").reformat(
                format=pix_fmt, dst_colorspace=matrix, dst_color_range=LIMITED
            )
            for target in (stream.codec_context, frame):
                for name, value in tags.items():
                    setattr(target, name, value)
            frame.pts = i
            film.mux(stream.encode(frame))
        film.mux(stream.encode())
    return file


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
    film = write_coded(
        tmp_path / name, signal, codec, pix_fmt, options, matrix=BT2020, transfer=transfer, primaries=BT2020
    )
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
    coding = {"matrix": BT709, "transfer": BT709, "primaries": primaries}
    film = write_coded(tmp_path / "film.mkv", signal, "ffv1", "yuv444p10le", {}, **coding)
    found = taken(film, 1)[0][1].astype(float)
    assert np.abs(found - shown).mean() < 0.012 * 255
    assert saturation(found) == pytest.approx(saturation(shown), rel=0.06)
