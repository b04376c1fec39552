"""What a file is, told from its first bytes, for the "found" of an error. Names of files prove nothing."""

from __future__ import annotations

HEAD_BYTES = 64  # enough for `told`
# Where a signature stands, the signature, and what it tells.
_SIGNATURES = (
    (0, b"\x89PNG\r\n\x1a\n", "a PNG"),
    (0, b"\xff\xd8\xff", "a JPEG"),
    (0, b"GIF8", "a GIF"),
    (0, b"%!PS", "PostScript"),
    (0, b"\xc5\xd0\xd3\xc6", "PostScript"),
    (0, b"%PDF", "a PDF"),
    (0, b"II*\x00", "a TIFF"),
    (0, b"MM\x00*", "a TIFF"),
    (0, b"BM", "a BMP"),
    (0, b"PK\x03\x04", "a ZIP archive"),
    (0, b"\x1f\x8b", "a gzip archive"),
    (0, b"\xfd7zXZ\x00", "an .xz archive"),
    (0, b"\x1aE\xdf\xa3", "a Matroska or WebM film"),
    (8, b"WEBP", "a WebP"),
    (8, b"AVI ", "an AVI film"),
    (4, b"ftypavi", "an AVIF"),
    (4, b"ftyphei", "a HEIC"),
    (4, b"ftyp", "an MP4"),
)
_SHOWN = 24  # characters of text


def told(head: bytes) -> str:
    """What the first HEAD_BYTES of a file tell that it is: "a PNG", "text that begins 'v=0 o=-'", "unknown data"."""
    if not head:
        return "an empty file"
    for start, signature, name in _SIGNATURES:
        if head[start:].startswith(signature):
            return name
    text = head[:_SHOWN].decode("utf-8", errors="ignore")
    if text.strip() and all(character.isprintable() or character in "\r\n\t" for character in text):
        return f"text that begins {' '.join(text.split())!r}"
    return "unknown data"
