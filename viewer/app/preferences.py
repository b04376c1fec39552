"""What is remembered from one start to the next: recent packs and settings, in one small JSON file.

A file that is missing, broken or from another version is no error: what cannot be understood keeps its default.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import platformdirs

from console.atomic import write_file

MOST_RECENT = 8


def default_file() -> Path:
    """Where the file lies on this machine."""
    return platformdirs.user_config_path("snerg", appauthor=False) / "viewer.json"


@dataclass
class Preferences:
    """window: width, height in screen units. recent: paths of packs, last opened first. moved, layout: see Interface."""

    window: tuple[int, int] = (1280, 800)
    page: str = "view"
    moved: list[str] = field(default_factory=list)
    layout: str = ""
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    target_fps: float = 30.0
    dynamic_resolution: bool = True
    rest_scale: float = 1.0
    recent: list[str] = field(default_factory=list)

    def opened(self, path: Path) -> None:
        """Puts a pack first among the recent ones."""
        name = str(Path(path).resolve())
        self.recent = [name, *(other for other in self.recent if other != name)][:MOST_RECENT]

    def recent_packs(self) -> list[Path]:
        """Those of the recent packs that are still there."""
        return [Path(name) for name in self.recent if Path(name).exists()]


def load(file: Path) -> Preferences:
    """The preferences in `file`, with defaults for what is missing or makes no sense."""
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        values = {}
    found = Preferences()
    for entry in fields(Preferences):
        if isinstance(values, dict) and entry.name in values:
            value = _like(values[entry.name], getattr(found, entry.name))
            if value is not None:
                setattr(found, entry.name, value)
    found.target_fps = min(max(found.target_fps, 5.0), 240.0)
    found.rest_scale = min(max(found.rest_scale, 0.1), 1.0)
    return found


def save(preferences: Preferences, file: Path) -> str | None:
    """Writes them aside and renames; why not, where that fails."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, json.dumps(asdict(preferences), indent=1))
    except OSError as error:
        return f"settings were not saved: {error}"
    return None


def _like(value: Any, default: Any) -> Any:
    """`value` if it is of the kind of `default`, else None."""
    if isinstance(default, bool | str):
        return value if isinstance(value, type(default)) else None
    if isinstance(default, float):
        return float(value) if _is_number(value) else None
    if isinstance(default, list):
        good = isinstance(value, list) and all(isinstance(item, str) for item in value)
        return value[:MOST_RECENT] if good else None
    kind = type(default[0])
    good = isinstance(value, list) and len(value) == len(default) and all(_is_number(v) and v >= 0 for v in value)
    return tuple(kind(v) for v in value) if good else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
