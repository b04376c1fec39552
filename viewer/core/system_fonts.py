"""The system's own fonts for letters that ours lack: Japanese, Arabic, Thai and so on, found beside the window.

fontconfig tells them where it is (Linux and its like), in the order that suits the user's language; Windows and macOS keep
theirs in known places. A font is taken for the letters it brings, so that few are; see SAMPLES.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

# A letter or two of each script that names and messages may be in.
SAMPLES = "ΩЖəệՀაשעعپअঅਅઅଅஅఅಅഅඅกກཀកကአあ漢汉한ㄅ∑⇒★☐"
SUFFIXES = (".ttf", ".otf", ".ttc", ".otc")
FORMAT = "%{file}\t%{index}\t%{color}\t%{charset}\n"
PATIENCE_S = 30.0  # fontconfig looks through all fonts when it is asked for the first time
LARGEST_BYTES = 64 << 20

WINDOWS = (
    *("segoeui.ttf", "YuGothR.ttc", "msgothic.ttc", "msyh.ttc", "msjh.ttc", "malgun.ttf", "Nirmala.ttc", "Nirmala.ttf"),
    *("LeelawUI.ttf", "mmrtext.ttf", "himalaya.ttf", "ebrima.ttf", "sylfaen.ttf", "seguisym.ttf"),
)
MACOS = (
    *("ヒラギノ角ゴシック W3.ttc", "PingFang.ttc", "Hiragino Sans GB.ttc", "AppleSDGothicNeo.ttc"),
    *("Supplemental/Arial Unicode.ttf", "GeezaPro.ttc", "ArialHB.ttc"),
    *("Kohinoor.ttc", "Thonburi.ttc", "Apple Symbols.ttf"),
)
UNIX = (  # where fontconfig's programs are not installed
    *("NotoSansCJK-Regular.ttc", "wqy-microhei.ttc", "wqy-zenhei.ttc"),
    *("DroidSansFallbackFull.ttf", "DroidSansFallback.ttf", "DejaVuSans.ttf"),
)


@dataclass(frozen=True)
class FontFile:
    """A font: its file, which of those in a collection, and the samples it has, where that is known."""

    path: Path
    number: int = 0
    brings: str = ""


def load_fonts(missing: str) -> list[FontFile]:
    """Fonts that have `missing` letters, the best first, read from the disk once: the window then finds them in memory."""
    try:
        found = [font for font in find_fonts(missing) if font.path.stat().st_size <= LARGEST_BYTES]
        for font in found:
            font.path.read_bytes()
        return found
    except OSError:  # boxes, then
        return []


def find_fonts(missing: str) -> list[FontFile]:
    if sys.platform == "win32":
        return _in_folder(Path(os.environ.get("SYSTEMROOT", "C:/Windows")) / "Fonts", WINDOWS)
    if sys.platform == "darwin":
        return _in_folder(Path("/System/Library/Fonts"), MACOS)
    return _by_fontconfig(missing)


def _in_folder(folder: Path, names: Iterable[str]) -> list[FontFile]:
    return [FontFile(folder / name) for name in names if (folder / name).is_file()]


def _by_fontconfig(missing: str) -> list[FontFile]:
    command = ["fc-match", "--sort", "--format", FORMAT, "sans-serif"]
    try:
        done = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, stdin=subprocess.DEVNULL)
    except (OSError, subprocess.TimeoutExpired):
        return [FontFile(path) for name in UNIX for path in Path("/usr/share/fonts").rglob(name)]
    return chosen_fonts(done.stdout.decode(errors="replace"), missing)


def chosen_fonts(listed: str, missing: str) -> list[FontFile]:
    """Of what fc-match lists (see FORMAT), the fonts to take, each for the letters that none before has."""
    chosen, left = [], set(missing)
    for line in listed.splitlines():
        path, index, colour, charset = (line.split("\t") + [""] * 4)[:4]
        if not left or colour == "True" or not path.lower().endswith(SUFFIXES):
            continue
        ranges = [_range(words) for words in charset.split()]
        brings = {letter for letter in left if any(low <= ord(letter) <= high for low, high in ranges)}
        if brings:
            number = int(index or 0) & 0xFFFF  # the upper half names an instance of a variable font
            chosen.append(FontFile(Path(path), number, "".join(sorted(brings))))
            left -= brings
    return chosen


def _range(words: str) -> tuple[int, int]:
    """ "3041-3096" or "3041", hexadecimal."""
    low, _, high = words.partition("-")
    return int(low, 16), int(high or low, 16)
