"""The marks of the open pack, and where they are kept: in a pack of ours that is a writable folder, else in a file of the user's.

A pack from elsewhere, and a .zip, is never changed. The user's file is named after what the pack says of itself, so that it is
found again when the pack was moved. Changes are written by a thread, a moment after the last one.
"""

from __future__ import annotations

import hashlib
import json
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import platformdirs

from console import not_written
from console.atomic import write_file
from console.json_text import read_json_file
from scenepack.metadata import metadata_writable, write_metadata
from scenepack.pack import Pack
from viewer.app.marks import Marks, marks_from_json, marks_to_json

if TYPE_CHECKING:
    from viewer.app.application import App

KEY = "marks"  # in the pack's "snerg" object
SETTLE_S = 0.4  # after the last change, before it is written


def default_folder() -> Path:
    """Where marks lie on this machine that cannot lie in their packs."""
    return platformdirs.user_data_path("snerg", appauthor=False) / "marks"


def file_for(pack: Pack, folder: Path) -> Path:
    """The file in `folder` with the marks of a pack that is not changed: the same wherever that lies."""
    own = {key: value for key, value in pack.params.items() if key != "snerg"}
    return folder / f"{hashlib.sha256(json.dumps(own, sort_keys=True, default=str).encode()).hexdigest()[:32]}.json"


@dataclass
class Marking:
    """marks: of the open pack. folder: of the user's files; None where nothing is written at all, as in scripts."""

    marks: Marks = field(default_factory=Marks)
    folder: Path | None = None
    _pack: Pack | None = None
    _path: Path | None = None  # of the pack whose marks are kept
    _saved: Marks = field(default_factory=Marks)
    _seen: Marks = field(default_factory=Marks)
    _since: float = 0.0
    _thread: threading.Thread | None = None
    _problem: str = ""
    _told: bool = False

    def take_up(self, app: App, pack: Pack, path: Path | None, marks: Marks | None = None) -> None:
        """Another pack is shown: those of the last are written, those of this one read. path: None where none are kept.

        marks: of this pack, where it was shown before and `pack` may know older ones.
        """
        self.leave()
        self._pack, self._path, self._told = pack, path, False
        if marks is None:
            marks = self._read(app, pack, path)
        self.marks = self._saved = self._seen = marks

    def _read(self, app: App, pack: Pack, path: Path | None) -> Marks:
        notes: list[str] = []
        own = pack.metadata.get(KEY)
        marks = marks_from_json(own, notes.append) if own is not None else Marks()
        if path is not None and self.folder is not None and not metadata_writable(pack, path):
            file = file_for(pack, self.folder)
            try:
                marks = marks_from_json(read_json_file(file), notes.append)
            except FileNotFoundError:
                pass
            except (OSError, ValueError) as error:
                notes.append(f"{file}: {error}")
        for note in dict.fromkeys(notes):
            app.messages.log(f"marks of this scene are left out: {note}", "warning")
        return marks

    def leave(self) -> None:
        """The pack is closed, or the program ends: what has changed is written now."""
        self._end_writing()
        if self.marks != self._saved:
            self._begin_writing()
            self._end_writing()
        self.marks = self._saved = self._seen = Marks()
        self._pack = self._path = None

    def change(self, app: App, marks: Marks) -> None:
        """Changes the marks, to be undone as one step."""
        if app.scene is not None and marks != self.marks:
            app.scene.rig.remember()
            self.marks = marks
            app.touch()

    def tick(self, app: App) -> None:
        """Time passes: what has not changed for a moment is written. A failure is told once a pack."""
        if self._thread is not None:
            if self._thread.is_alive():
                return
            self._end_writing()
        if self._problem and not self._told:
            self._told = True
            app.messages.say(self._problem, "warning")
            app.touch()
        now = time.monotonic()
        if self._seen is not self.marks:
            self._seen, self._since = self.marks, now
        elif self.marks != self._saved and now - self._since >= SETTLE_S:
            self._begin_writing()

    def _begin_writing(self) -> None:
        pack, path, folder, marks = self._pack, self._path, self.folder, self.marks
        self._saved = marks  # tried once
        if pack is None or path is None or folder is None:
            return

        def write() -> None:
            self._problem = _write(pack, path, folder, marks)

        self._thread = threading.Thread(target=write, name="snerg-marks")  # not a daemon: it is let finish
        self._thread.start()

    def _end_writing(self) -> None:
        if self._thread is not None:
            self._thread.join()
            self._thread = None


def _write(pack: Pack, path: Path, folder: Path, marks: Marks) -> str:
    """Writes marks where they belong; why not, where that fails."""
    document = None if marks.empty else marks_to_json(marks)
    try:
        if metadata_writable(pack, path):
            write_metadata(path, KEY, document)
            return ""
        file = file_for(pack, folder)
        if document is None:
            file.unlink(missing_ok=True)
        else:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_file(file, json.dumps(document, indent=1))
        return ""
    except OSError as error:
        words, remedy = not_written(error)
        return f"Measurements and bookmarks are not saved: {words}; {remedy}"
    except ValueError as error:
        return f"Measurements and bookmarks are not saved: {error}"
