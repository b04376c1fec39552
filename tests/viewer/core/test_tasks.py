"""Background work: what becomes of it when the program ends."""

import subprocess
import sys

ENDING = """
import sys
from viewer.core.tasks import Task

class Endless(Task[None]):
    def __init__(self):
        super().__init__(self._work)

    def _work(self):
        while not self.cancelled:
            pass
        print("given up")

Endless()
"""


def test_the_program_ends_after_its_tasks_have_given_up():
    done = subprocess.run([sys.executable, "-c", ENDING], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "given up\n", "")
