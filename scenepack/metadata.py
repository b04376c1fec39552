"""Changing what a pack on disk says of itself, without touching its images (docs/format.md, "Additional keys")."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from console.atomic import write_file
from console.json_text import read_json_file
from scenepack.files import PARAMS_NAME
from scenepack.pack import Pack


def metadata_writable(pack: Pack, path: Path) -> bool:
    """Whether `pack`, read from `path`, is a folder that snerg made and this user may change: others stay as they are."""
    file = path / PARAMS_NAME
    ours = isinstance(pack.params.get("snerg"), Mapping)
    return ours and file.is_file() and os.access(path, os.W_OK) and os.access(file, os.W_OK)


def write_metadata(folder: Path, key: str, value: Any) -> None:
    """Puts `value` under `key` of the "snerg" object of the pack in `folder`, atomically; None takes the key away.

    OSError where that fails, ValueError where the file has become something else meanwhile.
    """
    file = folder / PARAMS_NAME
    document = read_json_file(file)
    if not isinstance(document, dict) or not isinstance(document.get("snerg"), dict):
        raise ValueError(f"{file} is no pack of ours any more")
    document["snerg"].pop(key, None)
    if value is not None:
        document["snerg"][key] = value
    write_file(file, json.dumps(document))
