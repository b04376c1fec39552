"""Run as a process by test_atomic_writing: children die as if by kill -9 just before their first, second, … file system call.

Usage: python -m tests.scenepack.crashing_writer TARGET
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scenepack import load_pack, save_pack
from tests.scenepack.helpers import same_pack, small_pack

DIED = 77
# Of few files, since each is flushed to the disk.
PACKS = [small_pack(seed, block_size=2, grid_blocks=(2, 1, 1), occupancy=0.9) for seed in (1, 2)]


def die_at(step: int) -> None:
    """Makes the process end, with no clean-up, before the given call."""
    count = 0

    def dying(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal count
            count += 1
            if count == step:
                os._exit(DIED)
            return function(*args, **kwargs)

        return call

    for owner, name in ((os, "rename"), (os, "replace"), (os, "fsync"), (os, "unlink"), (os, "rmdir"), (os, "mkdir")):
        setattr(owner, name, dying(getattr(owner, name)))
    setattr(Path, "write_bytes", dying(Path.write_bytes))  # noqa: B010


def die_at_each_step(target: Path) -> None:
    """Prints a line for each step: the dead writer's status, which pack is found then, and whether all is
    tidy after the next writer. Forks here, in a process without the threads of a whole test run.
    """
    for step in range(1, 200):
        save_pack(PACKS[0], target, png_level=0)
        child = os.fork()
        if child == 0:
            die_at(step)
            save_pack(PACKS[1], target, png_level=0)
            os._exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        pack = load_pack(target)
        found = [name for name, known in zip(("old", "new"), PACKS, strict=True) if same_pack(pack, known)]
        save_pack(PACKS[0], target, png_level=0)
        tidy = not [name for name in os.listdir(target.parent) if name.startswith(".")]
        print(status, *found, "tidy" if tidy else "untidy", flush=True)
        if status == 0:
            return


if __name__ == "__main__":
    die_at_each_step(Path(sys.argv[1]))
