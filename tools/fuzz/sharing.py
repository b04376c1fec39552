"""Two processes that bake one pack together, and are interrupted: both, or one of the two while the other goes on.

python -m tools.fuzz.sharing RUN ... --out PACK starts them. Its exit status is that of the process that writes the pack.
"""

import contextlib
import os
import signal
import subprocess
import sys

from tools.fuzz.windows import working_on
from tools.fuzz.writer import MODULES, Writer


class SharingBake(Writer):
    """snerg-bake twice with one work folder. Kills strike both, then process 0 alone, then process 1 alone, and so on."""

    voices = 2
    kills = 0

    def line(self, out: str | os.PathLike[str]) -> list[str]:
        return [sys.executable, "-m", "tools.fuzz.sharing", *self.words, "--out", str(out)]

    def end(self, child: subprocess.Popen[str]) -> None:
        struck = (("0", "1"), ("0",), ("1",))[self.kills % 3]
        self.kills += 1
        out = str(child.args[-1])  # type: ignore[index]
        for number in working_on(out):
            with contextlib.suppress(OSError), open(f"/proc/{number}/cmdline", "rb") as line:
                words = line.read().decode().split("\0")
                if "--process-id" in words and words[words.index("--process-id") + 1] in struck:
                    os.kill(number, signal.SIGKILL)


def main(words: list[str]) -> int:
    line = [sys.executable, "-m", MODULES["bake"], *words, "--processes", "2", "--process-id"]
    writing, helping = (subprocess.Popen([*line, number]) for number in ("0", "1"))
    helped, wrote = helping.wait(), writing.wait()
    return wrote if helped in (0, 2, -signal.SIGKILL) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
