"""What nobody writes by mistake: values that break readers, and files that are something else."""

import io
import struct
import zipfile
from functools import cache

LARGE = {
    "@nested": "[" * 100 + "]" * 100,
    "@deeper": "[" * 200_000,
    "@long": '"' + "n" * 100_000 + '"',
    "@list": "[" + "0," * 50_000 + "0]",
    "@wide": "[" + ",".join(["[]"] * 20_000) + "]",
    "@keys": "{" + ",".join(f'"k{i}":0' for i in range(10_000)) + "}",
}


def raw_json(text: str) -> str:
    """The text that a name in LARGE stands for; itself where it stands for nothing."""
    return LARGE.get(text, text)


@cache
def contents() -> dict[str, bytes]:
    """Files of other kinds, by name: what a reader that goes by content would run, fetch or unpack."""
    zipped = io.BytesIO()
    with zipfile.ZipFile(zipped, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb", bytes(1 << 20))
    name = b"stream\0"
    return {
        "nothing": b"",
        "a byte": b"\0",
        "zeros": bytes(70_000),
        "text": b"hello\n" * 20,
        "ones": b"\xff" * 4096,
        "PostScript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n{} loop\n",
        "PDF": b"%PDF-1.4\n1 0 obj<<>>endobj\n",
        "GIF": b"GIF89a\x01\0\x01\0\0\0\0;",
        "BMP": b"BM" + struct.pack("<IHHIIiiHHIIiiII", 70, 0, 0, 54, 40, 2**30, 2**30, 1, 24, 0, 0, 0, 0, 0, 0),
        "TIFF": b"II*\0\x08\0\0\0\x03\0\0\x01\x03\0\x01\0\0\0\xff\xff\0\0\x01\x01\x03\0\x01\0\0\0\xff\xff\0\0\x11\x01",
        "SDP": b"v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\nm=video 5004 RTP/AVP 96\r\n",
        "playlist": b"#EXTM3U\n#EXTINF:1,\nfile:///etc/passwd\n",
        "concat": b"ffconcat version 1.0\nfile /etc/passwd\n",
        "SVG": b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"><image href="file:///etc/passwd"/></svg>',
        "pickle": b"\x80\x04\x95\x1c\0\0\0\0\0\0\0\x8c\x05posix\x94\x8c\x06system\x94\x93\x94\x8c\x04true\x94\x85\x94R\x94.",
        "zip": zipped.getvalue(),
        "gzip": b"\x1f\x8b\x08\0\0\0\0\0\0\x03" + name,
        "JSON": b"{}",
        "JSON list": b"[]",
        "not UTF-8": b'{"a": "\xff\xfe\xfd"}',
        "UTF-16": '{"a": 1}'.encode("utf-16"),
    }  # fmt: skip
