"""What lies under the name of a film is opened as H.264 in an MP4 or not at all: FFmpeg can do much more than decode."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baker.commands.pack import main
from console import UserError
from scenepack import load_pack, save_pack
from scenepack.codecs.base import CodecError
from scenepack.codecs.films import H264Codec
from tests.scenepack.helpers import small_pack

av = pytest.importorskip("av", reason="PyAV is not installed: pip install 'snerg[video]'")

PORT = 48734
UDP_TABLES = [Path("/proc/self/net/udp"), Path("/proc/self/net/udp6")]
# A session description: FFmpeg listens on the port that it names.
SDP = f"""v=0
o=- 0 0 IN IP4 127.0.0.1
s=film
c=IN IP4 127.0.0.1
t=0 0
m=video {PORT} RTP/AVP 96
a=rtpmap:96 H264/90000
"""


def listens() -> bool:
    """Whether a UDP socket of this machine is bound to PORT."""
    rows = [row for table in UDP_TABLES if table.is_file() for row in table.read_text().splitlines()[1:]]
    return any(row.split()[1].endswith(f":{PORT:04X}") for row in rows)


@pytest.mark.skipif(not UDP_TABLES[0].is_file(), reason="only Linux lists its sockets in /proc/self/net")
@pytest.mark.parametrize(
    "text", [SDP, SDP.replace("v=0\n", "v=0\nftyp\n"), "\0\0\0\x18ftypisom" + SDP], ids=["sdp", "ftyp line", "ftyp box"]
)
def test_text_that_reads_as_a_session_description_opens_no_socket(tmp_path, text, monkeypatch, capsys):
    folder, real = tmp_path / "pack", av.open
    save_pack(small_pack(), folder, codec="h264")
    opened: list[bool] = []  # for each film that PyAV is asked to open: whether the port was bound right afterwards

    def watched(*positional: Any, **named: Any) -> Any:
        try:
            return real(*positional, **named)
        finally:
            opened.append(listens())

    monkeypatch.setattr(av, "open", watched)
    (folder / "rgb_000.mp4").write_bytes(text.encode())
    with pytest.raises(UserError, match=r"rgb_000\.mp4"):
        load_pack(folder)
    with pytest.raises(CodecError):
        H264Codec().frames(text.encode(), (6, 16, 16), colour=True)  # though nothing looked at its head before
    assert not any(opened)
    assert main(["check", str(folder)]) == 2
    assert "Traceback" not in capsys.readouterr().err and not any(opened)


def film(container: str, *codecs: str) -> bytes:
    """Four frames of 32 × 32 in a stream of each codec."""
    data = io.BytesIO()
    with av.open(data, "w", format=container) as out:
        streams = [out.add_stream(codec, rate=25) for codec in codecs]
        for stream in streams:
            stream.width = stream.height = 32
            stream.pix_fmt = "yuv420p"
        for stream in streams:
            for i in range(4):
                frame = av.VideoFrame(32, 32, "yuv420p")
                frame.pts = i
                out.mux(stream.encode(frame))
            out.mux(stream.encode())
    return data.getvalue()


@pytest.mark.parametrize(
    "data, found",
    [
        (lambda: film("mp4", "mpeg4"), "it holds mp4v, expected one film of H.264"),
        (lambda: film("mp4", "libx264", "libx264"), "it holds avc1, avc1"),
        (lambda: film("matroska", "libx264"), "a Matroska or WebM film"),
        (lambda: film("avi", "libx264"), "an AVI film"),
        (lambda: b"#EXTM3U\nhttp://127.0.0.1/x.ts\n", "text that begins '#EXTM3U http"),
        (lambda: film("mp4", "libx264")[:300], "the film is damaged"),
        (lambda: b"", "an empty file"),
    ],
    ids=["another codec", "two streams", "matroska", "avi", "playlist", "cut off", "empty"],
)
def test_what_is_no_such_film_is_told_for_what_it_is(data: Any, found: str) -> None:
    with pytest.raises(CodecError) as raised:
        H264Codec().frames(data(), (4, 32, 32), colour=True)
    assert found in str(raised.value)


def test_frames_beyond_those_expected_are_not_decoded() -> None:
    frames = np.zeros((9, 32, 32), np.uint8)
    data = H264Codec().film(frames, "alpha", 90)
    with pytest.raises(CodecError, match="more than the 4 frames"):
        H264Codec().frames(data, (4, 32, 32), colour=False)
