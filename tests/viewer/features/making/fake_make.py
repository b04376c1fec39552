"""Stands in for snerg-make: says how far it is as the real commands do, and ends as HOW says.

python fake_make.py HOW FOLDER: "fail" ends with a line and status 2; "wait" works until it is interrupted, then notes
FOLDER/saved; "deaf" ignores interruptions; "until-told" works until there is FOLDER/go, then copies the pack FOLDER/source to
FOLDER/pack.
"""

import atexit
import os
import shutil
import signal
import sys
import time
from pathlib import Path

from console import Notice, UserError, notify, progress, run_command
from console.atomic import write_file


def work(how: str, folder: Path, /) -> None:
    # Text that a program would misread: only stage and metrics are for programs.
    with progress("the network learns", 100, stage="training") as bar:
        notify(Notice("a photograph is left out"))
        bar.update(40, "PSNR 99 of the last run", metrics={"psnr": 21.5, "rays_per_second": 3000.0})
        if how == "fail":
            raise UserError("the folder is empty", where=folder, remedy="choose another")
        if how == "deaf":
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            write_file(folder / "pid", str(os.getpid()))  # within: a test may interrupt as soon as it reads this
            while how in ("wait", "deaf") or (how == "until-told" and not (folder / "go").exists()):
                time.sleep(0.02)
        except KeyboardInterrupt as interrupt:
            (folder / "saved").touch()
            raise KeyboardInterrupt("saved at step 40") from interrupt
    shutil.copytree(folder / "source", folder / "pack")


if __name__ == "__main__":
    atexit.register(lambda: print("snerg-make: some library's last words", flush=True))
    sys.exit(run_command(work, prog="snerg-make"))
