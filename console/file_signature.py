"""File signatures: the type of a file from its first bytes, for the "found" of an error. Names of files prove nothing."""

HEAD_BYTES = 64  # enough for sniff_type
# Where a signature stands, the signature or several, and the type.
_SIGNATURES = (
    (0, b"\x89PNG\r\n\x1a\n", "a PNG"),
    (0, b"\xff\xd8\xff", "a JPEG"),
    (0, b"GIF8", "a GIF"),
    (0, (b"%!PS", b"\xc5\xd0\xd3\xc6"), "PostScript"),
    (0, b"%PDF", "a PDF"),
    (0, (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+"), "a TIFF"),
    (0, b"BM", "a BMP"),
    (0, b"PK\x03\x04", "a ZIP archive"),
    (0, b"\x1f\x8b", "a gzip archive"),
    (0, b"\xfd7zXZ\x00", "an .xz archive"),
    (0, b"\x1aE\xdf\xa3", "a Matroska or WebM film"),
    (0, b"\x76\x2f\x31\x01", "an OpenEXR"),
    (0, b"8BPS", "a Photoshop file"),
    (0, (b"\xff\x0a", b"\0\0\0\x0cJXL "), "a JPEG XL"),
    (0, (b"\0\0\0\x0cjP  ", b"\xff\x4f\xff\x51"), "a JPEG 2000"),
    (0, b"#?RADIANCE", "a Radiance HDR"),
    (0, b"FUJIFILMCCD-RAW", "a Fujifilm raw photograph"),
    (4, b"ftypcrx", "a Canon raw photograph"),
    (8, b"WEBP", "a WebP"),
    (8, b"AVI ", "an AVI film"),
    (4, b"ftypavi", "an AVIF"),
    (4, (b"ftyphei", b"ftyphev", b"ftypmif1", b"ftypmsf1"), "a HEIC"),
    (4, b"ftyp", "an MP4"),
)
_SHOWN = 24  # characters of text


def sniff_type(head: bytes) -> str:
    """The type of a file by its first HEAD_BYTES: "a PNG", "text that begins 'v=0 o=-'", "unknown data"."""
    if not head:
        return "an empty file"
    if head[4:12] in (b"ftypmif1", b"ftypmsf1") and b"avif" in head[12:]:  # one container, and two codecs
        return "an AVIF"
    for start, signatures, name in _SIGNATURES:
        if head[start:].startswith(signatures):
            return name
    text = head[:_SHOWN].decode("utf-8", errors="ignore")
    if text.strip() and all(character.isprintable() or character in "\r\n\t" for character in text):
        return f"text that begins {' '.join(text.split())!r}"
    return "unknown data"
