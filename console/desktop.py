"""Failures of a program that was started from a desktop: nobody reads its stderr there, so a box on the screen tells them.

What the system has for that is used: Windows' and macOS' own, on other systems zenity and the like; where there is
nothing, a text file on the desktop. It is waited for until the person has answered.
"""

import os
import shutil
import stat
import subprocess
import sys
import textwrap
import time
from contextlib import suppress
from pathlib import Path

import platformdirs

SHOWN_S = 2.0  # a program that lived so long has shown its box, whatever its exit status says
ERROR_ICON = 0x10  # of MessageBoxW
XMESSAGE_COLUMNS = 76

# What has boxes, the best first, and its options; KDE's own comes first there.
BOXES: dict[str, tuple[str, ...]] = {
    "zenity": ("--error", "--no-markup", "--width=520", "--title={title}", "--text={text}"),
    "kdialog": ("--title", "{title}", "--error", "{text}"),
    "xmessage": ("-center", "-title", "{title}", "{wrapped}"),
    "notify-send": ("--urgency=critical", "{title}", "{text}"),
}
MAC = "on run words\ndisplay alert (item 1 of words) message (item 2 of words) as critical\nend run"


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


def has_display() -> bool:
    """Whether a window can be shown, as far as the environment tells."""
    displays = os.environ.get("DISPLAY"), os.environ.get("WAYLAND_DISPLAY")
    return sys.platform in ("win32", "darwin") or any(displays)


def tell_if_unseen(title: str, text: str) -> None:
    """Where nobody would see it printed, and a desktop is there, shows a box with what the system has, or leaves a text file.

    Returns when it is closed. Never raises.
    """
    if not (has_display() and nobody_reads_stderr()):
        return
    with suppress(OSError, ValueError):  # nothing is left to tell it with
        if sys.platform == "win32":
            import ctypes

            ctypes.windll.user32.MessageBoxW(None, text, title, ERROR_ICON)
        elif not any(map(_ran, _boxes(title, text))):
            folder = platformdirs.user_desktop_path()
            folder = folder if folder.is_dir() else Path.home()
            (folder / f"{title} did not start.txt").write_text(textwrap.fill(text, 100) + "\n", encoding="utf-8")


def _boxes(title: str, text: str) -> list[list[str]]:
    if sys.platform == "darwin":
        return [["osascript", "-e", MAC, title, text]]
    on_kde = "KDE" in os.environ.get("XDG_CURRENT_DESKTOP", "").upper()
    words = {"title": title, "text": text, "wrapped": textwrap.fill(text, XMESSAGE_COLUMNS)}
    return [
        [name, *(option.format(**words) for option in BOXES[name])]
        for name in sorted(BOXES, key=lambda name: on_kde and name != "kdialog")
        if shutil.which(name)
    ]


def _ran(command: list[str]) -> bool:
    """Whether the box was there to be seen."""
    started = time.monotonic()
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    except OSError:
        return False
    return done.returncode == 0 or time.monotonic() - started > SHOWN_S
