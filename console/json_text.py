"""JSON that others wrote: packs, scenes, runs, settings. One reader, so that each of them is refused in the same words.

Numbers come out as they are written, but whole ones that no float64 holds exactly become float (and infinite beyond its
range), so that whoever asks whether a number is finite need not know of integers with a thousand digits.
"""

import errno
import json
from pathlib import Path
from typing import Any

from console.atomic import is_stream

MOST_BYTES = 16 << 20  # a thousand cameras take one of them
MOST_LEVELS = 64
_EXACT_DIGITS = 18


def parse_json(text: bytes | str, most: int = MOST_BYTES) -> Any:
    """The value of `text` (bytes are UTF-8). ValueError with the reason where it is no JSON, or none that anybody writes."""
    if len(text) > most:
        raise ValueError(f"more than {most >> 20} MiB")
    if isinstance(text, bytes):
        try:
            text = text.decode("utf-8-sig")
        except UnicodeDecodeError:
            raise ValueError("no text" if text else "an empty file") from None
    try:
        value = json.loads(
            text, parse_int=lambda digits: int(digits) if len(digits) <= _EXACT_DIGITS else float(digits)
        )
    except json.JSONDecodeError as error:
        reason = f"{error.msg} at line {error.lineno} column {error.colno}" if text.strip() else "an empty file"
        raise ValueError(reason) from None
    except RecursionError:
        raise ValueError(f"more than {MOST_LEVELS} levels") from None
    _require_plain(value)
    return value


def read_json_file(path: Path, most: int = MOST_BYTES) -> Any:
    """The value in the file `path`. ValueError as parse_json, OSError where it cannot be read, or is a pipe: nobody may write."""
    if is_stream(path):
        raise OSError(errno.EINVAL, "a device or a pipe, not a file", str(path))
    with open(path, "rb") as file:
        return parse_json(file.read(most + 1), most)


def _require_plain(value: Any) -> None:
    """ValueError where it is nested too deeply for whoever walks through it, or a string could be no name of a file."""
    level = [value]
    for _ in range(MOST_LEVELS):
        deeper: list[Any] = []
        for item in level:
            if isinstance(item, str):
                if "\0" in item:
                    raise ValueError("a string holds a NUL character")
            elif isinstance(item, dict | list):
                deeper.extend(item)
                deeper.extend(item.values() if isinstance(item, dict) else ())
        if not deeper:
            return
        level = deeper
    raise ValueError(f"more than {MOST_LEVELS} levels")
