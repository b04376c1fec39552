"""`python -m tools.open_window [PACK]`: opens a pack in a real window, 640 × 480, under a camera that never rests,
and prints when what of it was seen, and which frames took long. Without a PACK, one of 1000³ voxels is carved first. Figures
for a quiet machine; nothing is asserted.
"""

import sys
import tempfile
import time
from pathlib import Path

from scenepack import save_pack
from tools.scaling import carved_pack
from viewer.app.application import App
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.window.window import Window

SIDE = 1000  # voxels
SLOW_S = 0.1
PATIENCE_S = 120.0
TURN = 0.002  # of the window's height, a frame


def main(path: Path | None = None) -> None:
    """Opens a pack."""
    if path is not None:
        watch_it_open(path)
        return
    with tempfile.TemporaryDirectory(prefix="snerg-carved-") as folder:
        print(f"carving {SIDE}³ voxels")
        save_pack(carved_pack(SIDE), Path(folder) / "carved")
        watch_it_open(Path(folder) / "carved")


def watch_it_open(path: Path) -> None:
    """Prints the moments, in seconds since it was asked for."""
    app = App()
    with Window(app, (640, 480)) as window:
        window.draw_frames(5)
        app.resolution = DynamicResolution(target_fps=30)
        begin = last = time.perf_counter()
        moments: dict[str, float] = {}
        frames: list[tuple[float, float]] = []  # when each ended, and how long it took
        app.open(path)
        while "all of it is shown" not in moments and last - begin < PATIENCE_S:
            if app.scene is not None:
                app.scene.rig.orbit(TURN, 0.0)
                app.touch(1)
            window.step()
            now = time.perf_counter()
            for moment, there in (
                ("something to see", app.scene is not None),
                ("the pack is read", app.scene is not None and app.scene.whole),
                ("all of it is shown", _arrived(window)),
            ):
                if there:
                    moments.setdefault(moment, now - begin)
            if app.scene is not None:
                frames.append((now - begin, now - last))
            last = now
    for moment, seconds in moments.items():
        print(f"{seconds:6.2f} s  {moment}")
    first, *others = [seconds for _, seconds in frames] or [0.0]
    slow = sum(seconds > SLOW_S for seconds in others)
    print(f"the first frame took {first:.2f} s; of {len(others)} others, {slow} took over {SLOW_S} s; the slowest:")
    for at, seconds in sorted(frames[1:], key=lambda frame: -frame[1])[:3]:
        print(f"  {seconds:.2f} s, at {at:.1f} s")


def _arrived(window: Window) -> bool:
    scene, renderer = window.app.scene, window.canvas.renderer
    if scene is None or renderer is None:
        return False
    return scene.whole and not renderer.arriving and renderer.pack is scene.pack


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
