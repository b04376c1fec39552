"""Preferences: recent packs and settings in one JSON file, applied at the start and saved while the program runs.

A file that is missing, broken or from another version is no error: values that make no sense keep their defaults. Several
viewers may be open at once: each writes only what changed in it, and the list of recent packs holds those of all.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import platformdirs

from console import not_written
from console.atomic import write_file
from console.json_text import read_json_file
from scenepack.pack import number_in
from viewer.core.state import SCALES
from viewer.core.tasks import Autosave
from viewer.features.camera.walking import EYE_HEIGHTS
from viewer.features.display.display import PLAIN

if TYPE_CHECKING:
    from viewer.app.application import App

MOST_RECENT = 8
LARGEST = 1 << 16  # units of the screen
SETTLE_S = 0.4  # after the last change, before it is saved
LIMITS = {  # of numbers, which are brought to the nearest that makes sense
    "target_fps": (5.0, 240.0),
    "rest_scale": (0.1, 1.0),
    "interface_scale": (SCALES[0], SCALES[-1]),
    "dead_zone": (0.0, 0.5),
    "eye_height": EYE_HEIGHTS,
}
LONGEST_UNSAVED_S = 3.0  # for what keeps changing, such as an edge that is dragged


def default_file() -> Path:
    return platformdirs.user_config_path("snerg", appauthor=False) / "viewer.json"


@dataclass
class Preferences:
    """Those that no other part of the app holds."""

    window: tuple[int, int] = (1280, 800)  # width, height, screen units
    recent: list[str] = field(default_factory=list)  # paths, the last opened first

    def opened(self, path: Path) -> None:
        """Puts a pack first among the recent ones."""
        self.recent = merged_recent([str(Path(path).resolve())], self.recent)

    def recent_packs(self) -> list[Path]:
        """The recent packs that still exist."""
        return [Path(name) for name in self.recent if os.path.exists(name)]  # Path.exists raises for too long a name


def load(file: Path) -> dict[str, Any]:
    """The content of the file; empty if there is none or it is not valid."""
    try:
        values = read_json_file(file)
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}


def save(values: dict[str, Any], file: Path, before: dict[str, Any] | None = None) -> str | None:
    """Writes a new file and renames it. Returns what went wrong, or None.

    before: the values that this program last read or wrote. Only what differs from it is changed, because another viewer may have
    written since.
    """
    try:
        file = file.resolve()  # what a link leads to
        file.parent.mkdir(parents=True, exist_ok=True)
        there = load(file)
        if before is not None and there:
            opened = opened_since(before["recent"], values["recent"])
            values = {**values, "recent": merged_recent(opened, _like(there.get("recent"), []) or [])}
            values = {name: value for name, value in values.items() if value != before[name]}
        write_file(file, json.dumps({**there, **values}, indent=1))
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


def _like(value: Any, default: Any) -> Any:
    """`value` if it is of the kind of `default`, else None."""
    if isinstance(default, bool | str):
        return value if isinstance(value, type(default)) else None
    if isinstance(default, float):
        return number_in(value, -sys.float_info.max, sys.float_info.max)
    if isinstance(default, list):
        good = isinstance(value, list) and all(isinstance(item, str) for item in value)
        return value[:MOST_RECENT] if good else None
    kind = type(default[0])
    good = isinstance(value, list | tuple) and len(value) == len(default)
    return tuple(map(kind, value)) if good and all(number_in(v, 0, LARGEST) is not None for v in value) else None


# Where the app holds each preference, and under which name there. Of the backdrop, it is the style.
PLACES = {
    **{name: ("preferences", name) for name in ("window", "recent")},
    **{name: ("interface", name) for name in ("page", "moved", "layout", "theme", "axes_shown", "language")},
    "interface_scale": ("interface", "scale"),
    "dead_zone": ("controllers", "dead_zone"),
    "eye_height": ("walking", "eye_height_m"),
    "target_fps": ("resolution", "target_fps"),
    "dynamic_resolution": ("resolution", "enabled"),
    "rest_scale": ("resolution", "rest_scale"),
    **{name: ("settings", name) for name in ("background", "surroundings")},
}


def apply_preferences(app: App, values: dict[str, Any]) -> None:
    """Sets loaded preferences; those that are missing or not valid keep their present value."""
    for name, (part, there) in PLACES.items():
        value = _like(values.get(name), getattr(getattr(app, part), there))
        if value is None:
            continue
        if name in LIMITS:
            value = min(max(value, LIMITS[name][0]), LIMITS[name][1])
        if part == "settings":  # which are frozen
            app.set(**{there: value})
        else:
            setattr(getattr(app, part), there, value)
    style = _like(values.get("backdrop"), "") or "gradient"
    if style != PLAIN:
        app.set_backdrop(style)


def current_preferences(app: App) -> dict[str, Any]:
    values = {name: copy(getattr(getattr(app, part), there)) for name, (part, there) in PLACES.items()}
    backdrop = app.settings.backdrop
    return {**values, "backdrop": PLAIN if backdrop is None else backdrop.style}


class PreferencesAutosave:
    """Saves the preferences of `app` in a thread, soon after they change. size, layout: of the window."""

    def __init__(self, app: App, file: Path, size: Callable[[], tuple[int, int]], layout: Callable[[], str]) -> None:
        self.app, self.file, self._size, self._layout = app, file, size, layout
        self._written = current_preferences(self.app)  # what is in the file, as far as this program knows
        self._autosave = Autosave(self._save, self._written, SETTLE_S, LONGEST_UNSAVED_S)

    def poll(self) -> None:
        """Saves what has not changed for a moment. Call it from the loop."""
        if problem := self._autosave.new_problem():
            self.app.messages.say(problem[:1].upper() + problem[1:], "warning")
            self.app.touch()
        self._read_window()
        self._autosave.follow(current_preferences(self.app))

    def finish(self, *, window: bool = True) -> str | None:
        """Saves the last changes now (window: False if it is gone); a problem that was not reported before, or None."""
        if window:
            self._read_window()
        if self._autosave.problem is not None:  # what was refused is tried again
            self._autosave.saved = self._written
        self._autosave.finish(current_preferences(self.app))
        return self._autosave.new_problem()

    def _read_window(self) -> None:
        self.app.preferences.window, self.app.interface.layout = self._size(), self._layout()

    def _save(self, values: dict[str, Any]) -> str | None:
        problem = save(values, self.file, self._written)
        if problem is None:
            self._written = values
        return problem
