"""Films as photographs: the sharpest frame of each interval, upright; and what is no film is refused."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from console import UserError
from tests.training.posing.rooms import texture
from training.scenes.sources import find_source

av = pytest.importorskip("av", reason="films need PyAV (the extra video)")

from training.posing.film import glimpse, intervals_of, take_frames  # noqa: E402

WIDTH, HEIGHT = 192, 128
PORTRAIT = np.array(
    [0, 1 << 16, 0, -1 << 16, 0, 0, HEIGHT << 16, 0, 1 << 30], ">i4"
)  # as phones write it: turn clockwise


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
    file: Path, frames: list[np.ndarray], times: list[int], codec: str = "libx264", matrix: np.ndarray | None = None
):
    """A film whose frames are shown at `times` (milliseconds), with that display matrix in its header."""
    buffer = io.BytesIO()
    container = "webm" if file.suffix == ".webm" else "mp4"
    with av.open(buffer, "w", format=container) as film:
        stream = film.add_stream(
            codec, rate=1000, options={"crf": "12", "deadline": "realtime"} if codec.startswith("lib") else {}
        )
        stream.bit_rate = 8_000_000
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.time_base = "rgb24" if codec == "png" else "yuv420p", Fraction(1, 1000)
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
    frames = take_frames(film, folder, most, lambda *_: None)
    return [(f.seconds, np.asarray(Image.open(folder / f.name, formats=["JPEG"]).convert("RGB"))) for f in frames]


@pytest.mark.parametrize(("name", "codec"), [("walk.mp4", "libx264"), ("walk.mov", "mpeg4"), ("walk.webm", "libvpx")])
def test_the_sharpest_frame_of_each_interval_is_taken(name: str, codec: str, tmp_path: Path):
    film = write_film(tmp_path / name, frames_of_film(), [100 * i for i in range(24)], codec)
    source = find_source(tmp_path)
    assert source is not None and source.kind == "film" and source.files == (film,)
    found = taken(film)
    assert [round(seconds * 1000) for seconds, _ in found] == [100 * i for i in (2, 6, 10, 14, 18, 22)]
    assert all(picture.shape == (HEIGHT, WIDTH, 3) for _, picture in found)


def test_a_glimpse_of_a_film_counts_its_frames_and_shows_some_of_them_in_their_order(tmp_path: Path):
    film = write_film(tmp_path / "walk.mp4", frames_of_film(), [100 * i for i in range(24)], matrix=PORTRAIT)
    told: list[int] = []
    shown: list[tuple[float, tuple[int, int]]] = []
    count, seconds = glimpse(film, 6, 8, told.append, lambda _, at, picture: shown.append((at, picture.size)))
    assert told == [count] == [6] and seconds > 0
    assert len(shown) == 8 and [at for at, _ in shown] == sorted({at for at, _ in shown}) and shown[-1][0] > 1.8
    assert {size for _, size in shown} == {(HEIGHT, WIDTH)}  # upright


def test_a_film_of_a_phone_held_upright_comes_upright(tmp_path: Path):
    frames = frames_of_film()
    film = write_film(tmp_path / "walk.mp4", frames, [100 * i for i in range(24)], matrix=PORTRAIT)
    for seconds, picture in taken(film):
        expected = np.rot90(frames[round(seconds * 10)], -1).astype(float)  # clockwise
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
    assert intervals_of([0.0, 0.1, 0.2, 5.0, 10.0], 2) == [0, 0, 0, 1, 1]
    assert intervals_of([3.0], 5) == [0] and max(intervals_of([0.0, 1.0], 100)) == 5


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n", "text that begins '#EXTM3U"),
        (b"v=0\no=- 0 0 IN IP4 127.0.0.1\n", "text that begins 'v=0"),
        (b"ffconcat version 1.0\nfile /etc/passwd\n", "text that begins 'ffconcat"),
        (b"RIFF\x24\x00\x00\x00AVI LIST", "an AVI film"),
        (b"\x00\x00\x00\x18ftypisom" + bytes(64), "cannot be read"),
        (b"", "an empty file"),
    ],
)
def test_what_only_calls_itself_a_film_is_refused(content: bytes, told: str, tmp_path: Path):
    film = tmp_path / "film.mp4"
    film.write_bytes(content)
    with pytest.raises(UserError) as error:
        taken(film)
    assert told in str(error.value)


def test_a_codec_that_is_not_listed_is_refused_by_name(tmp_path: Path):
    film = write_film(tmp_path / "film.mp4", frames_of_film(2), [0, 40], codec="png")
    with pytest.raises(UserError, match=r"codec is not supported .*h264.*found png"):
        taken(film)
