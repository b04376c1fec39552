"""The log and dialogs of the viewer, and the file that describes a crash.

It holds versions, commands and messages, and Python's traceback, or faulthandler's where a driver or a library ends the
process. The next start finds the files of processes that are gone and reports them.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import platform
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import platformdirs

from console import UserError, refusal
from console.atomic import try_lock
from console.errors import handle_notices

if TYPE_CHECKING:
    from viewer.features.making.make_job import RejectedPhotographs

KEPT_LINES = 500
TOAST_S, READING_S, LONGEST_TOAST_S = 4.0, 0.05, 20.0  # at least; more for each letter of a warning; at most
BUG = "This is a bug in snerg"
Buttons = tuple[tuple[str, str], ...]  # labels and command ids
OK: Buttons = (("OK", ""),)


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
    title: str
    text: str
    buttons: Buttons = OK
    failed: bool = True  # what was wanted did not come about; False where it is only good to know
    rejected: RejectedPhotographs | None = None  # photographs that are shown with it


@dataclass
class Messages:
    lines: deque[LogLine] = field(default_factory=lambda: deque(maxlen=KEPT_LINES))
    dialogs: list[Dialog] = field(default_factory=list)
    toast: str = ""
    toast_level: str = "info"
    toast_until: float = 0.0  # time.monotonic()
    crash_log: Callable[[str], object] = lambda text: None  # writes messages and commands to the crash log at once
    _toast_seen: str = ""

    def log(self, text: str, level: str = "info") -> None:
        self.lines.append(LogLine(level, " ".join(text.split()), time.time()))
        self.crash_log(f"{level}: {text}")

    def say(self, text: str, level: str = "info") -> None:
        self.log(text, level)
        self.show_toast(text, level)

    def show_toast(self, text: str, level: str = "info") -> None:
        """Shows `text` for a few seconds; a warning as long as it takes to be read."""
        more = READING_S * len(text) if level != "info" else 0.0
        self.toast, self.toast_level = text, level
        self.toast_until = time.monotonic() + min(TOAST_S + more, LONGEST_TOAST_S)

    def toast_changed(self) -> bool:
        """Whether a toast has come or gone since this was asked last, so that it must be drawn or taken away."""
        before, self._toast_seen = self._toast_seen, self.toast if self.toast_left > 0 else ""
        return self._toast_seen != before

    def fail(
        self, title: str, error: BaseException | str, buttons: Buttons = OK, rejected: RejectedPhotographs | None = None
    ) -> None:
        """Opens a dialog, and logs it. A bug of ours is called one, with its traceback in the log."""
        text = error if isinstance(error, str) else in_plain_words(error)
        self.log(f"{title}: {text}", "error")
        if isinstance(error, BaseException) and text.startswith(BUG):
            for line in traceback.format_exception(error):
                self.log(line, "error")
        self.dialogs.append(Dialog(title, text, buttons, rejected=rejected))

    @contextmanager
    def as_dialog(self, title: str) -> Iterator[None]:
        """Shows an exception that the `with` block raises in a dialog, instead of raising it."""
        try:
            yield
        except Exception as error:
            self.fail(title, error)

    @contextmanager
    def noting_warnings(self, *, dialog: bool = True) -> Iterator[None]:
        """Logs the notices of the `with` block, such as a pack too large for the GPU; dialog: shows them as well."""

        def note(text: str) -> None:
            self.log(text, "warning")
            if dialog:
                self.dialogs.append(Dialog("Shown with less detail", text[:1].upper() + text[1:], failed=False))

        with handle_notices(note):
            yield

    @property
    def toast_left(self) -> float:
        """Seconds that the toast stays; 0 where there is none."""
        return max(0.0, self.toast_until - time.monotonic()) if self.toast else 0.0


def in_plain_words(error: BaseException) -> str:
    if isinstance(error, UserError | ValueError) and str(error):
        return str(error)
    text = refusal(error)
    if text is None and isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return text or f"{BUG}. The log page has its traceback ({type(error).__name__}: {error})."


# --- Crash log ---

RUNNING, CRASHED = "running-", "crash-"
KEPT = 5  # crash logs; older ones are removed
PACKAGES = ("snerg", "imgui-bundle", "glfw", "moderngl", "numpy")


def default_folder() -> Path:
    return Path(platformdirs.user_log_path("snerg", appauthor=False))


class CrashLog:
    """The file of this process, while it can be written and until it ends."""

    def __init__(self, folder: Path) -> None:
        self._file: TextIO | None = None
        with contextlib.suppress(OSError, ValueError):
            folder.mkdir(parents=True, exist_ok=True)
            path = folder / f"{RUNNING}{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.log"
            self._file = open(path, "w", encoding="utf-8", errors="replace")  # noqa: SIM115  (for as long as it runs)
            try_lock(self._file.fileno())
            faulthandler.enable(self._file)
        self.add(versions())

    def add(self, text: str) -> None:
        """Writes a line and flushes it, so that it outlasts the process."""
        if self._file is None:
            return
        with contextlib.suppress(OSError, ValueError):  # a full disk
            line = text if "\n" in text else f"{time.strftime('%H:%M:%S')} {' '.join(text.split())}"
            self._file.write(f"{line}\n")
            self._file.flush()

    def end(self) -> None:
        """Removes the file, because the program ends normally; not after crash()."""
        if (path := self._close()) is not None:
            with contextlib.suppress(OSError):
                path.unlink()

    def crash(self, error: BaseException) -> bool:
        """Logs the exception that ends the program; whether there is a file that describes it."""
        self.add("".join(traceback.format_exception(error)))
        return self._close() is not None

    def _close(self) -> Path | None:
        if self._file is None:
            return None
        faulthandler.disable()
        with contextlib.suppress(OSError):
            self._file.close()
        path, self._file = Path(self._file.name), None
        return path


def versions() -> str:
    lines = [f"snerg's viewer, started {time.strftime('%Y-%m-%d %H:%M:%S')}"]
    lines.append(f"Python {platform.python_version()}, {platform.platform()}")
    for package in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            lines.append(f"{package} {metadata.version(package)}")
    names = ("XDG_SESSION_TYPE", "WAYLAND_DISPLAY", "DISPLAY")
    screen = " ".join(f"{name}={os.environ[name]}" for name in names if name in os.environ)
    return "\n".join([*lines, screen or sys.platform])


def left_behind(folder: Path) -> list[Path]:
    """Renames the logs of viewers that crashed and returns them, the newest last. Each is returned once."""
    found = []
    for file in sorted(folder.glob(f"{RUNNING}*.log")):
        if _in_use(file):
            continue
        crashed = file.with_name(CRASHED + file.name.removeprefix(RUNNING))
        with contextlib.suppress(OSError):  # another viewer was faster; or, on Windows, it is in use
            file.rename(crashed)
            found.append(crashed)
    for old in sorted(folder.glob(f"{CRASHED}*.log"))[:-KEPT]:
        with contextlib.suppress(OSError):
            old.unlink()
    return found


def _in_use(file: Path) -> bool:
    """Whether the viewer that writes the file still runs."""
    with contextlib.suppress(OSError), open(file, "rb") as opened:
        locked = try_lock(opened.fileno())
        return locked is False or (locked is None and os.name == "posix")  # elsewhere it cannot be renamed meanwhile
    return True
