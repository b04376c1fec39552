"""The picture on the system's clipboard. GLFW knows text only, so on Linux another process holds the picture.

On Wayland that is wl-copy, if it is installed; otherwise, and on X11, viewer.app.x11_clipboard (desktops with XWayland hand its
picture on). It ends with this program.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import sys
import threading

import numpy as np
from PIL import Image

from console import UserError
from console.python_command import module_command
from viewer.app import x11_clipboard

REMEDY = "save it with Ctrl+S instead"


class PictureClipboard:
    """Where pictures are copied to; keeps the process that holds the last one."""

    def __init__(self) -> None:
        self._holder: subprocess.Popen[bytes] | None = None
        self._said: list[str] = []
        self._listening: threading.Thread | None = None

    def begin(self, picture: np.ndarray) -> None:
        """Puts a picture, uint8 [h, w, 3], there: answered() tells when it has arrived. UserError where that is impossible."""
        file = io.BytesIO()
        Image.fromarray(picture).save(file, format="PNG", compress_level=4)
        command = _holder_command()
        self.release()
        self._said = []
        self._holder = holder = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self._listening = threading.Thread(target=self._hand_over, args=(holder, file.getvalue()), daemon=True)
        self._listening.start()

    def answered(self) -> bool:
        """Whether the picture is on the clipboard; False while it is on its way. UserError where it cannot be put there."""
        if self._listening is None or self._listening.is_alive():
            return False
        said = self._said[0] if self._said else "nothing"
        if said != x11_clipboard.OWNED:
            large = said == x11_clipboard.TOO_LARGE
            what = "the picture is too large for the clipboard" if large else "the clipboard cannot be reached"
            raise UserError(what, found=None if large else said, remedy=REMEDY)
        return True

    def release(self) -> None:
        """The process ends; a picture that is still on the clipboard goes with it."""
        holder, self._holder = self._holder, None
        if holder is not None:
            with contextlib.suppress(OSError):
                holder.stdin.close()  # type: ignore[union-attr]
            try:
                holder.wait(5)
            except subprocess.TimeoutExpired:
                holder.kill()
                holder.wait()
            holder.stdout.close()  # type: ignore[union-attr]

    def _hand_over(self, holder: subprocess.Popen[bytes], data: bytes) -> None:
        assert holder.stdin is not None and holder.stdout is not None
        try:
            if holder.args[0] == sys.executable:  # type: ignore[index]
                holder.stdin.write(len(data).to_bytes(8, "little"))
                holder.stdin.write(data)
                holder.stdin.flush()
                self._said = [holder.stdout.readline().decode(errors="replace").strip()]
            else:  # wl-copy goes on in the background when it has it
                holder.stdin.write(data)
                holder.stdin.close()
                self._said = [x11_clipboard.OWNED if holder.wait() == 0 else "wl-copy failed"]
        except (OSError, ValueError) as error:
            self._said = [str(error)]


def _holder_command() -> list[str]:
    if not sys.platform.startswith("linux"):
        raise UserError("pictures can be copied on Linux only", remedy=REMEDY)
    wayland = os.environ.get("WAYLAND_DISPLAY")
    if wayland and (program := shutil.which("wl-copy")):
        return [program, "--type", "image/png"]
    if not os.environ.get("DISPLAY"):
        remedy = "install wl-clipboard (Debian, Ubuntu: apt-get install wl-clipboard)" if wayland else REMEDY
        raise UserError("there is no clipboard for pictures", remedy=remedy)
    return module_command("viewer.app.x11_clipboard")
