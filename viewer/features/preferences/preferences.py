"""Preferences: recent packs and settings in one JSON file, applied at the start and saved while the program runs.

A file that is missing, broken or from another version is no error: values that make no sense keep their defaults. Several
viewers may be open at once: each writes only what changed in it, and the list of recent packs holds those of all.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs

from console import not_written
from console.atomic import write_file
from console.json_text import read_json_file
from viewer.core.annotations import is_number
from viewer.core.tasks import Autosave
from viewer.features.camera.walking import EYE_HEIGHTS, USUAL_M
from viewer.features.display.display import PLAIN

if TYPE_CHECKING:
    from viewer.app.application import App

MOST_RECENT = 8
LARGEST = 1 << 16  # units of the screen
CHECK_EVERY_S = 0.4
LIMITS = {  # of numbers, which are brought to the nearest that makes sense
    "target_fps": (5.0, 240.0),
    "rest_scale": (0.1, 1.0),
    "interface_scale": (0.75, 2.0),
    "dead_zone": (0.0, 0.5),
    "eye_height": EYE_HEIGHTS,
}
LONGEST_UNSAVED_S = 3.0  # for what keeps changing, such as an edge that is dragged


def default_file() -> Path:
    return platformdirs.user_config_path("snerg", appauthor=False) / "viewer.json"


@dataclass
class Preferences:
    """What is kept from one start to the next. Fields without a comment are those of Interface and DynamicResolution."""

    window: tuple[int, int] = (1280, 800)  # width, height, screen units
    page: str = "view"
    moved: list[str] = field(default_factory=list)
    layout: str = ""
    background: tuple[float, float, float] = (1.0, 1.0, 1.0)  # sRGB, 0 … 1
    target_fps: float = 30.0
    dynamic_resolution: bool = True
    rest_scale: float = 1.0
    theme: str = "dark"
    language: str = "en"
    interface_scale: float = 1.0
    backdrop: str = "gradient"  # "plain" or one of viewer.features.display.display.STYLES
    axes_shown: bool = True
    surroundings: bool = True  # see RenderSettings
    dead_zone: float = 0.15  # of controllers, 0 … 1
    eye_height: float = USUAL_M  # see Walking.eye_height_m
    recent: list[str] = field(default_factory=list)  # paths, the last opened first

    def opened(self, path: Path) -> None:
        """Puts a pack first among the recent ones."""
        self.recent = merged_recent([str(Path(path).resolve())], self.recent)

    def recent_packs(self) -> list[Path]:
        """The recent packs that still exist."""
        return [Path(name) for name in self.recent if os.path.exists(name)]  # Path.exists raises for too long a name


def load(file: Path) -> Preferences:
    """The preferences in `file`, with defaults for what is missing or makes no sense."""
    defaults = vars(Preferences())
    found = {name: _like(value, defaults[name]) for name, value in _read(file).items() if name in defaults}
    found = {name: value for name, value in found.items() if value is not None}
    found |= {name: min(max(found[name], low), high) for name, (low, high) in LIMITS.items() if name in found}
    return Preferences(**found)


def save(preferences: Preferences, file: Path, before: Preferences | None = None) -> str | None:
    """Writes a new file and renames it. Returns what went wrong, or None.

    before: what this program last read or wrote. Only what differs from it is changed, because another viewer may have
    written since.
    """
    try:
        file = file.resolve()  # what a link leads to
        file.parent.mkdir(parents=True, exist_ok=True)
        there, wanted = _read(file), asdict(preferences)
        if before is not None and there:
            old = asdict(before)
            opened = opened_since(before.recent, preferences.recent)
            wanted["recent"] = merged_recent(opened, _like(there.get("recent"), []) or [])
            wanted = {name: value for name, value in wanted.items() if value != old[name]}
        write_file(file, json.dumps({**there, **wanted}, indent=1))
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
    """The content of the file; empty if there is none or it is not valid."""
    try:
        values = read_json_file(file)
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}


def _like(value: Any, default: Any) -> Any:
    """`value` if it is of the kind of `default`, else None."""
    if isinstance(default, bool | str):
        return value if isinstance(value, type(default)) else None
    if isinstance(default, float):
        return float(value) if is_number(value) else None
    if isinstance(default, list):
        good = isinstance(value, list) and all(isinstance(item, str) for item in value)
        return value[:MOST_RECENT] if good else None
    kind = type(default[0])
    good = isinstance(value, list) and len(value) == len(default)
    return tuple(map(kind, value)) if good and all(is_number(v) and 0 <= v <= LARGEST for v in value) else None


# The part of the app that holds a preference, and the name there. The settings' are not among them, for these are frozen.
PLACES = {
    **{name: ("interface", name) for name in ("page", "moved", "layout", "theme", "axes_shown", "language")},
    "interface_scale": ("interface", "scale"),
    "dead_zone": ("controllers", "dead_zone"),
    "eye_height": ("walking", "eye_height_m"),
    "target_fps": ("resolution", "target_fps"),
    "dynamic_resolution": ("resolution", "enabled"),
    "rest_scale": ("resolution", "rest_scale"),
}


def apply_preferences(app: App, preferences: Preferences) -> None:
    app.preferences = preferences
    for name, (part, there) in PLACES.items():
        setattr(getattr(app, part), there, copy(getattr(preferences, name)))
    app.settings = replace(app.settings, background=preferences.background, surroundings=preferences.surroundings)
    if preferences.backdrop != PLAIN:
        app.set_backdrop(preferences.backdrop)


def current_preferences(app: App) -> Preferences:
    settings = app.settings
    values: dict[str, Any] = {"recent": list(app.preferences.recent)}
    values |= {name: copy(getattr(getattr(app, part), there)) for name, (part, there) in PLACES.items()}
    values["backdrop"] = PLAIN if settings.backdrop is None else settings.backdrop.style
    return replace(app.preferences, background=settings.background, surroundings=settings.surroundings, **values)


class PreferencesAutosave:
    """Saves the preferences of `app` in a thread, soon after they change. size, layout: of the window; see Preferences."""

    def __init__(self, app: App, file: Path, size: Callable[[], tuple[int, int]], layout: Callable[[], str]) -> None:
        self.app, self.file, self._size, self._layout = app, file, size, layout
        self._written = current_preferences(self.app)  # what is in the file, as far as this program knows
        self._autosave = Autosave(self._save, self._written, CHECK_EVERY_S, LONGEST_UNSAVED_S)
        self._checked_at = time.monotonic()
        self._problem: str | None = None  # why the last changes are not saved
        self._was_reported = False

    def poll(self) -> None:
        """Saves what changed and then stayed the same until the next check. Call it from the loop."""
        now = time.monotonic()
        if now - self._checked_at >= CHECK_EVERY_S:
            self._checked_at = now
            if self._problem is not None and not self._was_reported:
                self._was_reported = True
                self.app.messages.say(self._problem[:1].upper() + self._problem[1:], "warning")
                self.app.touch()
            self._read_window()
            self._autosave.follow(current_preferences(self.app))

    def finish(self, *, window: bool = True) -> str | None:
        """Saves the last changes now (window: False if it is gone); a problem that was not reported before, or None."""
        if window:
            self._read_window()
        if self._problem is not None:  # what was refused is tried again
            self._autosave.saved = self._written
        self._autosave.finish(current_preferences(self.app))
        return None if self._was_reported else self._problem

    def _read_window(self) -> None:
        self.app.preferences.window, self.app.interface.layout = self._size(), self._layout()

    def _save(self, wanted: Preferences) -> None:
        self._problem = save(wanted, self.file, self._written)
        if self._problem is None:
            self._written = wanted
