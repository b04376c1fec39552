"""Crash log: a file that records what the viewer did last. A normal end removes it; after a crash it stays.

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
from importlib import metadata
from pathlib import Path
from typing import TextIO

import platformdirs

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

RUNNING, CRASHED = "running-", "crash-"
KEPT = 5  # crash logs; older ones are removed
MOST_BYTES = 1 << 20  # of a log; a longer one starts again
PACKAGES = ("snerg", "imgui-bundle", "glfw", "moderngl", "numpy")


def default_folder() -> Path:
    """Where the logs lie on this machine."""
    return Path(platformdirs.user_log_path("snerg", appauthor=False))


class CrashLog:
    """The file of this process. path: None if it cannot be written; then nothing is logged."""

    def __init__(self, folder: Path) -> None:
        self.path: Path | None = folder / f"{RUNNING}{os.getpid()}.log"
        self._file: TextIO | None = None
        self._ended = False
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = open(self.path, "w", encoding="utf-8", errors="replace")  # noqa: SIM115  (for as long as it runs)
            if fcntl is not None:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            faulthandler.enable(self._file)
        except (OSError, ValueError):
            self.path = None
        self.add(versions())

    def add(self, text: str) -> None:
        """Writes a line and flushes it, so that it outlasts the process."""
        if self._file is None or self._ended:
            return
        try:
            if self._file.tell() > MOST_BYTES:  # after a long session only the end matters
                self._file.seek(0)
                self._file.truncate()
                self._file.write(versions() + "\n…\n")
            self._file.write(
                f"{time.strftime('%H:%M:%S')} {' '.join(text.split())}\n" if "\n" not in text else f"{text}\n"
            )
            self._file.flush()
        except (OSError, ValueError):  # a full disk
            return

    def end(self) -> None:
        """Removes the file, because the program ends normally."""
        self._close()
        if self.path is not None:
            with contextlib.suppress(OSError):
                self.path.unlink()

    def crash(self, error: BaseException) -> Path | None:
        """Logs the exception that ends the program; returns the file, if there is one."""
        self.add("".join(traceback.format_exception(error)))
        self._close()
        return self.path

    def _close(self) -> None:
        if self._file is not None and not self._ended:
            self._ended = True
            faulthandler.disable()
            with contextlib.suppress(OSError):
                self._file.close()


def versions() -> str:
    """Versions of Python, the system and the libraries."""
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
    for file in sorted(folder.glob(f"{RUNNING}*.log"), key=_changed):
        if _in_use(file):
            continue
        when = time.strftime("%Y%m%d-%H%M%S", time.localtime(_changed(file)))
        crashed = file.with_name(f"{CRASHED}{when}-{file.stem.removeprefix(RUNNING)}.log")
        try:
            file.rename(crashed)
        except OSError:  # another viewer was faster; or, on Windows, it is in use
            continue
        found.append(crashed)
    for old in sorted(folder.glob(f"{CRASHED}*.log"), key=_changed)[:-KEPT]:
        with contextlib.suppress(OSError):
            old.unlink()
    return [file for file in found if file.exists()]


def _changed(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0


def _in_use(file: Path) -> bool:
    """Whether the viewer that writes the file still runs."""
    if fcntl is None:
        return False
    try:
        with open(file, "rb") as opened:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    return False
