"""Open prompt: the line that a path is typed into, and what it suggests."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import unquote, urlsplit

from training.scenes.sources import FILMS
from viewer.core.files import SESSION_SUFFIX, FileRequest, Kind, kind_of, pack_in

if TYPE_CHECKING:
    from viewer.app.application import App

SHOWN = 8
MOST_ENTRIES = 5000  # of a folder that are looked at
OPENABLE = (".zip", SESSION_SUFFIX, *FILMS)


def path_in(text: str) -> Path | None:
    """The existing path that a text names, as file managers and shells copy paths; None for any other text."""
    text = text.strip().splitlines()[0].strip() if text.strip() else ""
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        text = text[1:-1]
    if text.startswith("file://"):
        text = unquote(urlsplit(text).path)
    if not looks_like_path(text):
        return None
    path = expanded(text)
    return path if os.path.exists(path) else None


def expanded(text: str) -> Path:
    """The path with ~ replaced by the home folder; unchanged if there is no such user, as in ~0."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)


def looks_like_path(text: str) -> bool:
    """Whether a text can only be meant as a path."""
    text = text.strip().strip("'\"")
    return text.startswith(("/", "~", "./", "../", "file://")) or Path(text).is_absolute()


@dataclass
class OpenPrompt:
    recent: Sequence[Path]  # packs that were opened lately
    other: bool = False  # whether it asks for a pack to compare with
    text: str = ""  # as typed
    picked: int | None = None  # index of the suggestion that Enter opens; None: the typed path
    problem: str = ""  # why the typed path cannot be opened
    _listed: tuple[str, list[Path]] | None = None
    _kinds: dict[Path, Kind] = field(default_factory=dict)

    @property
    def lines(self) -> list[Path]:
        """Suggestions below the text; see suggestions()."""
        if self._listed is None or self._listed[0] != self.text:
            self._listed = self.text, suggestions(self.text, self.recent)
        return self._listed[1]

    def kind(self, path: Path) -> Kind:
        if path not in self._kinds:
            try:
                self._kinds[path] = kind_of(path)
            except OSError:
                self._kinds[path] = "unknown"
        return self._kinds[path]

    def type(self, text: str) -> None:
        if text != self.text:
            self.text, self.picked, self.problem = text, None, ""

    def step(self, by: int) -> None:
        """Moves the selection; up from the first suggestion returns to the text."""
        at = (-1 if self.picked is None else self.picked) + by
        self.picked = None if at < 0 else min(at, len(self.lines) - 1) if self.lines else None

    def take(self, line: int | None = None) -> Path | None:
        """The path to open: the suggestion given, that picked, or what is typed. None where the prompt stays open."""
        picked = self.picked if line is None else line
        if picked is None and (named := path_in(self.text)) is not None:
            return named
        if picked is None and looks_like_path(self.text):
            self.problem = f"There is nothing at {self.text.strip()}."
            return None
        if picked is None and not (self.text.strip() and self.lines):
            self.problem = "Type a path, or choose one."
            return None
        path = self.lines[picked or 0]
        if path.is_dir() and self.kind(path) == "unknown":
            self.type(str(path) + os.sep)
            return None
        return path


def suggestions(text: str, recent: Sequence[Path]) -> list[Path]:
    """At most SHOWN paths: openable entries of the folder that is typed, else recent paths that hold every word of the text."""
    if looks_like_path(text):
        return _entries(text.strip())
    words = text.lower().split()
    return [path for path in recent if all(word in str(path).lower() for word in words)][:SHOWN]


def _entries(text: str) -> list[Path]:
    typed = expanded(text)
    folder, stem = (typed, "") if text.endswith((os.sep, "/")) or text == "~" else (typed.parent, typed.name.lower())
    found: list[tuple[bool, str, str]] = []  # folders come first
    try:
        with os.scandir(folder) as entries:
            for entry in islice(entries, MOST_ENTRIES):
                name = entry.name.lower()
                shown = name.startswith(stem) and (stem.startswith(".") or not name.startswith("."))
                if shown and (entry.is_dir() or name.endswith(OPENABLE)):
                    found.append((not entry.is_dir(), name, entry.name))
    except (OSError, ValueError):
        return []
    return [folder / name for _, _, name in sorted(found)[:SHOWN]]


def ask_to_open(app: App, *, other: bool = False) -> None:
    """Asks what to open. other: for a pack to compare with."""
    app.open_prompt = OpenPrompt(app.preferences.recent_packs(), other)


def choose(app: App, line: int | None = None) -> None:
    """Takes what is chosen in that question: the line given, or what Enter takes."""
    assert app.open_prompt is not None
    path, other = app.open_prompt.take(line), app.open_prompt.other
    if path is not None:
        app.open_prompt = None
        _open(app, path, other)
    app.touch()


def browse(app: App, kind: Literal["open", "folder"], *, other: bool = False) -> None:
    """Replaces the prompt by a file dialog, for a file or for a folder."""
    app.open_prompt = None
    title = "Compare with a pack" if other else "Open a pack, photographs, a film or a training run"
    suffixes = () if kind == "folder" else (".zip",) if other else OPENABLE
    app.file_request = FileRequest(title, kind, lambda path: _open(app, path, other), suffixes)


def _open(app: App, path: Path, other: bool) -> None:
    app.open(pack_in(path), other=True) if other else app.drop([path])
