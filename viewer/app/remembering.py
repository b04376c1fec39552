"""Saves settings, layout and recent packs while the program runs, so that nothing is lost however it ends.

The loop calls `look` now and then; what has changed, and then stayed as it is for a moment, is written by a thread.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from viewer.app.application import App
from viewer.app.carried_over import to_remember
from viewer.app.preferences import Preferences, merged_recent, opened_since, save

LOOK_EVERY_S = 0.4
LONGEST_UNSAVED_S = 3.0  # of something that goes on changing, as while an edge is dragged


class Keeper:
    """Keeps `file` up to date with what `app` remembers. size: the window's, in units. layout: where its pages are docked."""

    def __init__(self, app: App, file: Path, size: Callable[[], tuple[int, int]], layout: Callable[[], str]) -> None:
        self.app, self.file, self._size, self._layout = app, file, size, layout
        self._saved = self._copy()
        self._seen = self._saved
        self._changed_at = self._looked_at = time.monotonic()
        self._refused: Preferences | None = None  # what could not be written
        self._problem: str | None = None
        self._told = False
        self._writing: threading.Thread | None = None
        self._sent = self._written = self._saved

    def _copy(self) -> Preferences:
        """What is to be remembered, as of now; of the window, as of the last look."""
        return replace(to_remember(self.app), recent=list(self.app.preferences.recent))

    def look(self) -> None:
        """Has what changed saved; call from the loop, as often as is handy."""
        now = time.monotonic()
        if now - self._looked_at < LOOK_EVERY_S:
            return
        self._looked_at = now
        if self._writing is not None:
            if self._writing.is_alive():
                return
            self._take_result()
        self._notice()
        seen, self._seen = self._seen, self._copy()
        if self._seen in (self._saved, self._refused):
            self._changed_at = now
        elif seen == self._seen or now - self._changed_at > LONGEST_UNSAVED_S:
            self._write()

    def finish(self, *, window: bool = True) -> str | None:
        """Saves the last changes, here and now; why not, where that fails and nobody was told.

        window: False where the window cannot be asked any more.
        """
        if self._writing is not None:
            self._writing.join()
            self._take_result()
        if window:
            self._notice()
        self._seen = self._copy()
        if self._seen != self._saved:
            self._write()
            assert self._writing is not None
            self._writing.join()
            told = self._told
            self._take_result()
            return None if told else self._problem
        return None

    def _notice(self) -> None:
        """Asks the window what only it knows."""
        self.app.preferences.window, self.app.interface.layout = self._size(), self._layout()

    def _write(self) -> None:
        self._sent, self._written = self._seen, replace(self._seen, recent=list(self._seen.recent))
        before = self._saved

        def write() -> None:
            self._problem = save(self._written, self.file, before)

        self._writing = threading.Thread(target=write, name="snerg-settings")  # not a daemon: it is let finish
        self._writing.start()

    def _take_result(self) -> None:
        """What the thread has done: packs that other viewers opened are shown here, too; a failure is told, once."""
        self._writing = None
        if self._problem is not None:
            self._refused = self._sent
            if not self._told:
                self._told = True
                self.app.messages.say(self._problem[:1].upper() + self._problem[1:], "warning")
                self.app.touch()
            return
        recent = self.app.preferences.recent
        self.app.preferences.recent = merged_recent(opened_since(self._sent.recent, recent), self._written.recent)
        self._saved, self._refused = self._written, None
