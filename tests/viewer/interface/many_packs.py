"""Opens many packs from disk, one after the other, and prints what memory they left behind: a process of its own.

    python -m tests.viewer.interface.many_packs WARM_UP PACKS ROUNDS TOLERATED PACK [PACK ...]

Prints JSON: host and card, bytes held after the warm-up and after each round of PACKS, [before, after, after, ...], and as many
open descriptors. A round in which no more than the share TOLERATED is added is the last: what is forgotten is forgotten in
every round.
"""

import json
import sys
from pathlib import Path

import moderngl

from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.waiting import not_none, until
from tools.fuzz.memory import resident, with_steady_memory
from viewer.app.application import App


def open_descriptors() -> int:
    """How many files, pipes and the like this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))


def open_and_look(ui: OffscreenUi, path: Path, *, other: bool = False) -> None:
    """Opens a pack from disk as a user does, and draws it."""
    ui.app.open(path, other=other)
    until(lambda: not_none(ui.app.loading).finished)
    ui.frames(4)
    assert ui.app.scene is not None and not ui.app.messages.dialogs


def open_and_close(ui: OffscreenUi, packs: list[Path], times: int) -> None:
    """Opens `times` packs in turn, now and then a second one beside, and closes each."""
    for i in range(times):
        open_and_look(ui, packs[i % len(packs)])
        if i % 10 == 4:
            open_and_look(ui, packs[(i + 1) % len(packs)], other=True)
        ui.app.close()
        ui.frames(2)


def main(warm_up: str, times: str, rounds: str, tolerated: str, *packs: str) -> None:
    """See the module."""
    ctx = moderngl.create_context(standalone=True, backend="egl")  # pyright: ignore[reportArgumentType]
    ui = OffscreenUi(ctx, App(), size=(480, 360))
    ui.app.resolution.enabled = False
    paths = [Path(pack) for pack in packs]
    open_and_close(ui, paths, int(warm_up))
    held = [(resident(), ui.canvas.gpu_bytes, open_descriptors())]
    for _ in range(int(rounds)):
        open_and_close(ui, paths, int(times))
        held.append((resident(), ui.canvas.gpu_bytes, open_descriptors()))
        if held[-1][0] < (1 + float(tolerated)) * held[-2][0]:
            break
    assert ctx.error == "GL_NO_ERROR"
    print(json.dumps(dict(zip(("host", "card", "descriptors"), zip(*held, strict=True), strict=True))))


if __name__ == "__main__":
    with_steady_memory("tests.viewer.interface.many_packs")
    main(*sys.argv[1:])
