"""What is remembered from one start to the next: recent packs and settings, in one small JSON file.

A file that is missing, broken or from another version is no error: what cannot be understood keeps its default. Several
viewers may be open at once: each writes only what was changed in it, and the packs of all are remembered.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import platformdirs

from console import not_written
from console.atomic import write_file
from console.json_text import read_json_file

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

MOST_RECENT = 8
LOCK_PATIENCE_S = 2.0
WHITE = (1.0, 1.0, 1.0)
LARGEST = 1 << 16  # units of the screen


def default_file() -> Path:
    """Where the file lies on this machine."""
    return platformdirs.user_config_path("snerg", appauthor=False) / "viewer.json"


@dataclass
class Preferences:
    """window: width, height in screen units. recent: paths of what was opened, the last first. moved, layout, theme,
    interface_scale (its scale), axes_shown: see Interface. background: plain, sRGB in 0 … 1. backdrop: "plain" or one of
    viewer.app.backdrops.STYLES. surroundings: see RenderSettings. dead_zone: of controllers, 0 … 1.
    """

    window: tuple[int, int] = (1280, 800)
    page: str = "view"
    moved: list[str] = field(default_factory=list)
    layout: str = ""
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)
    target_fps: float = 30.0
    dynamic_resolution: bool = True
    rest_scale: float = 1.0
    theme: str = "dark"
    interface_scale: float = 1.0
    backdrop: str = "gradient"
    axes_shown: bool = True
    surroundings: bool = True
    dead_zone: float = 0.15
    recent: list[str] = field(default_factory=list)

    def opened(self, path: Path) -> None:
        """Puts a pack first among the recent ones."""
        self.recent = merged_recent([str(Path(path).resolve())], self.recent)

    def recent_packs(self) -> list[Path]:
        """Those of the recent packs that are still there."""
        return [
            Path(name) for name in self.recent if os.path.exists(name)
        ]  # Path.exists raises where a name is too long


def load(file: Path) -> Preferences:
    """The preferences in `file`, with defaults for what is missing or makes no sense."""
    values = _read(file)
    found = Preferences()
    for entry in fields(Preferences):
        if entry.name in values:
            value = _like(values[entry.name], getattr(found, entry.name))
            if value is not None:
                setattr(found, entry.name, value)
    found.target_fps = min(max(found.target_fps, 5.0), 240.0)
    found.rest_scale = min(max(found.rest_scale, 0.1), 1.0)
    found.interface_scale = min(max(found.interface_scale, 0.75), 2.0)
    found.dead_zone = min(max(found.dead_zone, 0.0), 0.5)
    if "backdrop" not in values and found.background != WHITE:
        found.backdrop = "plain"  # a colour was chosen before there were others
    return found


def save(preferences: Preferences, file: Path, before: Preferences | None = None) -> str | None:
    """Writes them aside and renames; why not, where that fails.

    before: what this program last read or wrote; only what differs from it is changed, for another viewer may have
    written since. `preferences.recent` becomes what both have opened.
    """
    try:
        file = file.resolve()  # what a link leads to
        file.parent.mkdir(parents=True, exist_ok=True)
        with _locked(file):
            there, wanted = _read(file), asdict(preferences)
            if before is not None and there:
                old = asdict(before)
                opened = opened_since(before.recent, preferences.recent)
                others = _like(there.get("recent"), []) or []
                wanted["recent"] = merged_recent(opened, others)
                wanted = {name: value for name, value in wanted.items() if value != old[name]}
            write_file(file, json.dumps({**there, **wanted}, indent=1))
        preferences.recent = list(wanted.get("recent", preferences.recent))
    except OSError as error:
        words, remedy = not_written(error)
        return f"settings are not saved: {file.parent}: {words}; {remedy}"
    return None


def opened_since(before: list[str], after: list[str]) -> list[str]:
    """The packs at the head of `after` that were opened since `before` was the list."""
    tails = (after[i:] for i in range(len(after) + 1))
    rest = next(tail for tail in tails if tail == [name for name in before if name in tail])
    return after[: len(after) - len(rest)]


def merged_recent(opened: list[str], others: list[str]) -> list[str]:
    """`others` with the packs just `opened` first."""
    return [*opened, *(name for name in others if name not in opened)][:MOST_RECENT]


def _read(file: Path) -> dict[str, Any]:
    """What the file holds; nothing where there is none, or none that makes sense."""
    try:
        values = read_json_file(file)
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}


@contextmanager
def _locked(file: Path) -> Iterator[None]:
    """Holds a lock while one viewer reads and writes; without it where another keeps it too long, or none is to be had."""
    if fcntl is not None:
        handle = os.open(file.parent, os.O_RDONLY)  # the folder: the file itself is another one after each save
    else:
        handle = os.open(file.with_name(f"{file.name}.lock"), os.O_RDWR | os.O_CREAT, 0o600)
    try:
        end = time.monotonic() + LOCK_PATIENCE_S
        while not _lock(handle) and time.monotonic() < end:
            time.sleep(0.02)
        yield
    finally:
        os.close(handle)  # which ends the lock


def _lock(handle: int) -> bool:
    """Takes the lock; False where another has it. True, too, on file systems without locks."""
    try:
        if fcntl is not None:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        elif sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True


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
    good = (
        isinstance(value, list)
        and len(value) == len(default)
        and all(_is_number(v) and 0 <= v <= LARGEST for v in value)
    )
    return tuple(kind(v) for v in value) if good else None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
