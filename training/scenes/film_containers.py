"""Containers of films: what each is called, its suffixes, its MIME types, and the first bytes that tell it.

A film is opened with the one FFmpeg demuxer that its first bytes name. FFmpeg's own guess knows playlists and lists of files,
which lead to other files and to the network; none of the demuxers here does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

HEAD_BYTES = 1024  # of a film that tell its container
STILLS = (b"avif", b"avis", b"heic", b"heix", b"hevc", b"heim", b"heis", b"mif1", b"msf1", b"jxl ", b"crx ")


@dataclass(frozen=True)
class Container:
    name: str  # for messages
    demuxer: str  # FFmpeg's
    suffixes: tuple[str, ...]
    mime_types: tuple[str, ...]
    recognises: Callable[[bytes], bool]  # a file's first HEAD_BYTES


def _is_mp4(head: bytes) -> bool:
    """QuickTime may begin with any of these boxes. Brands of stills (HEIC, AVIF, CR3) are none of films."""
    kind = head[4:8]
    return kind in (b"moov", b"mdat", b"wide", b"free", b"skip") or (kind == b"ftyp" and head[8:12] not in STILLS)


def _is_transport_stream(head: bytes) -> bool:
    """Packets of 188 bytes begin with 0x47; cameras (M2TS, MTS) put a time of 4 bytes before each."""
    return any(len(head) > first + 3 * size and all(head[first + i * size] == 0x47 for i in range(4))
               for first, size in ((0, 188), (4, 192), (0, 204)))  # fmt: skip


CONTAINERS = (
    Container("MP4, MOV, 3GP", "mp4", (".mp4", ".m4v", ".mov", ".qt", ".3gp", ".3g2"),
              ("video/mp4", "video/quicktime", "video/3gpp", "video/3gpp2"), _is_mp4),
    Container("WebM, Matroska", "matroska", (".webm", ".mkv"), ("video/webm", "video/x-matroska"),
              lambda head: head.startswith(b"\x1a\x45\xdf\xa3")),
    Container("AVI", "avi", (".avi", ".divx"), ("video/x-msvideo",),
              lambda head: head.startswith(b"RIFF") and head[8:12] in (b"AVI ", b"AVIX")),
    Container("MTS", "mpegts", (".ts", ".mts", ".m2ts", ".m2t"), ("video/mp2t",), _is_transport_stream),
    Container("MPEG", "mpeg", (".mpg", ".mpeg", ".vob"), ("video/mpeg",),
              lambda head: head.startswith(b"\0\0\1\xba")),
    Container("WMV", "asf", (".wmv", ".asf"), ("video/x-ms-wmv", "video/x-ms-asf"),
              lambda head: head.startswith(b"\x30\x26\xb2\x75\x8e\x66\xcf\x11")),
    Container("FLV", "flv", (".flv", ".f4v"), ("video/x-flv",), lambda head: head.startswith(b"FLV\1")),
    Container("Ogg", "ogg", (".ogv", ".ogm"), ("video/ogg",), lambda head: head.startswith(b"OggS")),
)  # fmt: skip
FILMS = tuple(suffix for container in CONTAINERS for suffix in container.suffixes)
FILM_NAMES = ", ".join(container.name for container in CONTAINERS)  # for messages
DEMUXERS = ",".join(["mov", "webm", *(container.demuxer for container in CONTAINERS)])  # as FFmpeg's format_whitelist


def container_of(film: Path) -> Container | None:
    """A film's container by its first bytes; None for any other file."""
    with film.open("rb") as file:
        head = file.read(HEAD_BYTES)
    return next((container for container in CONTAINERS if container.recognises(head)), None)
