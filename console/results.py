"""The figures of a command as JSON, for scripts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from console.atomic import write_file
from console.errors import UserError


def write_json(path: Path | None, value: dict[str, Any]) -> bool:
    """Writes `value` where `--json` asks for it; True where that is stdout ("-") and nothing else should be printed.

    UserError where it cannot be written.
    """
    if path is None:
        return False
    text = json.dumps(value, indent=2)
    if str(path) == "-":
        print(text)
        return True
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, text + "\n")
    except OSError as error:
        raise UserError(f"cannot be written: {error.strerror or error}", where=path) from error
    return False
