"""Failures of a program that was started from a desktop: nobody reads its stderr there, so a box on the screen tells them.

What the system has for that is used: Windows' and macOS' own, on other systems zenity and the like; where there is
nothing, a text file on the desktop. It is waited for until the person has answered.
"""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import platformdirs

SHOWN_S = 2.0  # a program that lived so long has shown its box, whatever its exit status says
ERROR_ICON = 0x10  # of MessageBoxW
XMESSAGE_COLUMNS = 76
Command = Callable[[str, str], list[str]]

# By program, its command line for (title, text), the best first; KDE's own comes first there.
BOXES: dict[str, Command] = {
    "zenity": lambda title, text: [
        "zenity",
        "--error",
        "--no-markup",
        "--width=520",
        f"--title={title}",
        f"--text={text}",
    ],
    "kdialog": lambda title, text: ["kdialog", "--title", title, "--error", text],
    "qarma": lambda title, text: ["qarma", "--error", f"--title={title}", f"--text={text}"],
    "matedialog": lambda title, text: ["matedialog", "--error", f"--title={title}", f"--text={text}"],
    "xmessage": lambda title, text: ["xmessage", "-center", "-title", title, textwrap.fill(text, XMESSAGE_COLUMNS)],
    "notify-send": lambda title, text: ["notify-send", "--urgency=critical", title, text],
}


def nobody_reads_stderr() -> bool:
    """Whether what is printed reaches nobody: no terminal, and no program at the other end of a pipe."""
    if sys.stderr is None or sys.__stderr__ is None:  # pythonw, whatever stands in for it
        return True
    try:
        number = sys.stderr.fileno()
        kind = os.fstat(number).st_mode
    except (OSError, ValueError):  # a test's, say
        return False
    if sys.platform == "win32" or os.isatty(number) or stat.S_ISFIFO(kind):
        return False
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY))
    except OSError:
        return True  # a desktop's log, its journal, or /dev/null
    return False  # typed on a terminal, with 2> somewhere


def tell_if_unseen(prog: str, line: str) -> None:
    """Shows `line` on the desktop where nobody would see it printed, and a desktop is there."""
    desktop = sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if desktop and nobody_reads_stderr():
        show_box(prog, line)


def show_box(title: str, text: str) -> None:
    """Shows a box with what the system has, or leaves a text file; returns when it is closed. Never raises."""
    try:
        if sys.platform == "win32":
            import ctypes

            ctypes.windll.user32.MessageBoxW(None, text, title, ERROR_ICON)
        elif not any(_ran(command(title, text)) for command in _boxes()):
            _leave_file(title, text)
    except (OSError, ValueError):  # nothing is left to tell it with
        pass


def _boxes() -> list[Command]:
    if sys.platform == "darwin":
        script = "on run words\ndisplay alert (item 1 of words) message (item 2 of words) as critical\nend run"
        return [lambda title, text: ["osascript", "-e", script, title, text]]
    names = sorted(BOXES, key=lambda name: name != "kdialog") if "KDE" in _desktop() else list(BOXES)
    return [BOXES[name] for name in names if shutil.which(name)]


def _desktop() -> str:
    return os.environ.get("XDG_CURRENT_DESKTOP", "").upper()


def _ran(command: list[str]) -> bool:
    """Whether the box was there to be seen."""
    started = time.monotonic()
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    except OSError:
        return False
    return done.returncode == 0 or time.monotonic() - started > SHOWN_S


def _leave_file(title: str, text: str) -> None:
    folder = platformdirs.user_desktop_path()
    folder = folder if folder.is_dir() else Path.home()
    (folder / f"{title} did not start.txt").write_text(textwrap.fill(text, 100) + "\n", encoding="utf-8")
