"""What the program has to say: a log of lines, short-lived toasts, and dialogs that wait for the user."""

from __future__ import annotations

import time
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from console import Notice, UserError, refusal
from viewer.app.rejected_photographs import RejectedPhotographs

KEPT_LINES = 500
TOAST_S, READING_S, LONGEST_TOAST_S = 4.0, 0.05, 20.0  # at least; more for each letter of a warning; at most
BUG = "This is a bug in snerg"


@dataclass(frozen=True)
class LogLine:
    """level: "info", "warning" or "error"; when: wall-clock seconds since the epoch."""

    level: str
    text: str
    when: float

    @property
    def clock(self) -> str:
        return time.strftime("%H:%M:%S", time.localtime(self.when))


@dataclass(frozen=True)
class Dialog:
    """A message to be answered. details: the whole story, for those who want it. buttons: labels and command ids.

    failed: what was wanted did not come about; False where it is only good to know. rejected: photographs that are shown with it.
    """

    title: str
    text: str
    details: str = ""
    buttons: tuple[tuple[str, str], ...] = (("OK", ""),)
    failed: bool = True
    rejected: RejectedPhotographs | None = None


@dataclass
class Messages:
    """All that was said so far."""

    lines: deque[LogLine] = field(default_factory=lambda: deque(maxlen=KEPT_LINES))
    dialogs: list[Dialog] = field(default_factory=list)
    toast: str = ""
    toast_level: str = "info"
    toast_until: float = 0.0  # time.monotonic()
    crash_log: Callable[[str], object] = lambda text: None  # writes messages and commands to the crash log at once
    _toast_told: str = ""

    def log(self, text: str, level: str = "info") -> None:
        """Adds a line to the log."""
        self.lines.append(LogLine(level, " ".join(text.split()), time.time()))
        self.crash_log(f"{level}: {text}")

    def say(self, text: str, level: str = "info") -> None:
        """Shows `text` for a few seconds, and logs it."""
        self.log(text, level)
        self.show_toast(text, level)

    def show_toast(self, text: str, level: str = "info") -> None:
        """Shows `text` for a few seconds; a warning as long as it takes to be read."""
        more = READING_S * len(text) if level != "info" else 0.0
        self.toast, self.toast_level = text, level
        self.toast_until = time.monotonic() + min(TOAST_S + more, LONGEST_TOAST_S)

    def toast_changed(self) -> bool:
        """Whether a toast has come or gone since this was asked last, so that it must be drawn or taken away."""
        told, self._toast_told = self._toast_told, self.toast if self.toast_left > 0 else ""
        return self._toast_told != told

    def fail(
        self,
        title: str,
        error: BaseException | str,
        details: str = "",
        buttons: tuple[tuple[str, str], ...] = (("OK", ""),),
        rejected: RejectedPhotographs | None = None,
    ) -> None:
        """Opens a dialog, and logs it. A bug of ours is told as one, with its traceback in the log."""
        text = error if isinstance(error, str) else in_plain_words(error)
        self.log(f"{title}: {text}", "error")
        if isinstance(error, BaseException) and text.startswith(BUG):
            for line in traceback.format_exception(error):
                self.log(line, "error")
        self.dialogs.append(Dialog(title, text, details, buttons, rejected=rejected))

    @contextmanager
    def noting_warnings(self, *, told: bool = True) -> Iterator[None]:
        """What the `with` block warns of, that a card has no room for the whole pack, is logged; and told where `told`."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", Notice)
            yield
        for warning in caught:
            if issubclass(warning.category, Notice):
                text = str(warning.message)
                self.log(text, "warning")
                if told:
                    self.dialogs.append(Dialog("Shown with less detail", text[:1].upper() + text[1:], failed=False))

    @property
    def toast_left(self) -> float:
        """Seconds that the toast stays; 0 where there is none."""
        return max(0.0, self.toast_until - time.monotonic()) if self.toast else 0.0


def in_plain_words(error: BaseException) -> str:
    """What went wrong, for a dialog."""
    if isinstance(error, UserError | ValueError) and str(error):
        return str(error)
    told = refusal(error)
    if told is None and isinstance(error, OSError) and error.strerror:
        told = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return told or f"{BUG}. The log page has its traceback ({type(error).__name__}: {error})."
