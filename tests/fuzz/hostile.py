"""What nobody writes by mistake: numbers and values that break readers, and files that are something else."""

import io
import json
import random
import struct
import zipfile
from functools import cache
from typing import Any

_LARGE = {
    "@nested": "[" * 100 + "]" * 100,
    "@deeper": "[" * 200_000,
    "@long": '"' + "n" * 100_000 + '"',
    "@list": "[" + "0," * 50_000 + "0]",
    "@wide": "[" + ",".join(["[]"] * 20_000) + "]",
    "@keys": "{" + ",".join(f'"k{i}":0' for i in range(10_000)) + "}",
}
# As they stand in a JSON file; json.dumps would not write most of them.
RAW = (
    "0", "-1", "1", "2", "255", "256", "65535", "65536", "2147483647", "2147483648", "4294967296", "9223372036854775808",
    "1" + "0" * 400, "-" + "7" * 5000, "1e308", "-1e308", "1e-308", "1e999", "-1e999", "1e30", "1e-300", "0.5", "-0.0",
    "Infinity", "-Infinity", "NaN", "true", "false", "null", "[]", "{}", '""', '"text"', '"0"', '"NaN"', '"1e999"', "[null]",
    '{"x": {}}', "[[1, 2], [3]]", "[[1e308, 1e308, 1e308, 1e308]]", '"a\\u0000b"', '"\\ud800"', '"\\u001b[31m\\u0007"',
    '"two\\nlines\\u2028\\u202e"', '"../../../../etc/passwd"', '"/dev/zero"', '"/"', '"."', '""', '"~"', '"con\\\\x"',
    *_LARGE,
)  # fmt: skip
WHOLE = (
    0, 1, 2, 3, 127, 128, 255, 256, 1023, 4096, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**63,
    2**64 - 1,
)  # fmt: skip
FLOATS = (0.0, -1.0, 1e-300, 1e30, 1e300, float("inf"), float("-inf"), float("nan"))


def raw_json(text: str) -> str:
    """The text that a name in RAW stands for; itself where it stands for nothing."""
    return _LARGE.get(text, text)


def value_for(random: random.Random, old: Any) -> str:
    """JSON text in place of `old`: something hostile, or something a little different."""
    if isinstance(old, bool) or random.random() < 0.6:
        return random.choice(RAW)
    if isinstance(old, int | float):
        changed = [old + 1, old - 1, -old, old * 2, old * 1000, old / 3, old * random.uniform(0.5, 2), round(old) + 0.5]
        return json.dumps(random.choice(changed))
    if isinstance(old, str):
        half = len(old) // 2
        others = [old[:half], old + "x", old.upper(), old * 3, f"../{old}", f"/{old}", old[half:]]
        return json.dumps(random.choice(others))
    if isinstance(old, list) and old:
        several = [old[:-1], old[1:], old + old, [*old, old[0]], [old], old[0], list(reversed(old)), old * 40]
        return json.dumps(random.choice(several))
    return random.choice(RAW)


def number_of(random: random.Random, size: int) -> int:
    """A whole number of `size` bytes that a header's reader may not expect."""
    return random.choice([*WHOLE, random.getrandbits(8 * size)]) % 256**size


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
