"""A display of our own, that nobody sees."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

SCREEN = (1400, 900)


@contextmanager
def virtual_screen(program: str = "Xvfb") -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """An Xvfb that ends with the `with` block, and its DISPLAY. FileNotFoundError where it is not installed."""
    read, write = os.pipe()
    # -noreset: else it starts over, deaf for a moment, whenever the last window closes
    shape = f"{SCREEN[0]}x{SCREEN[1]}x24"
    command = [program, "-displayfd", str(write), "-screen", "0", shape, "-nolisten", "tcp", "-noreset"]
    server = subprocess.Popen(command, pass_fds=(write,), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        assert number, "Xvfb does not start"
        yield f":{number}", server
    finally:
        server.terminate()
        server.wait(10)
