"""`python -m tools.fly_window [PACK] [FPS]`: flies around and through a pack in a real window
and prints how well frames held their target by the real clock. A figure for a quiet machine; nothing is asserted.
"""

import sys
from pathlib import Path

import numpy as np

from scenepack import Pack, load_pack
from viewer.app.application import App
from viewer.features.film.camera_path import CameraPath, Keyframe
from viewer.rendering.camera import ViewCamera
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.window.window import Window

DEMO = Path(__file__).parents[1] / "viewer" / "demo" / "demo.zip"
# azimuth and elevation in degrees, distance from the middle in half sides of the grid, seconds to the next
STOPS = (
    (0, 25, 6.0, 1.5),
    (60, 20, 3.0, 1.0),
    (110, 15, 1.6, 1.0),
    (150, 10, 0.7, 1.0),
    (200, 35, 0.35, 0.8),
    (260, 20, 1.2, 1.2),
    (330, 40, 4.0, 1.5),
    (360, 25, 6.0, 1.0),
)


def flight(pack: Pack) -> CameraPath:
    """Around and through `pack`: far away, close by, through the middle, and out again, with views of very different cost."""
    half = 0.5 * float(np.max(pack.max_xyz - pack.min_xyz))
    keys = []
    for azimuth, elevation, distance, seconds in STOPS:
        camera = ViewCamera.orbit(pack, azimuth, elevation, distance * half, 45.0)
        keys.append(Keyframe(camera.grid_T_camera, 45.0, seconds))
    return CameraPath(keys)


class Noting(DynamicResolution):
    """Notes each frame that drew the moving picture: milliseconds, and the scale that it was drawn at."""

    def __init__(self, target_fps: float) -> None:
        super().__init__(target_fps=target_fps)
        self.frames: list[tuple[float, float]] = []

    def frame_ended(self, frame_ms: float, swap_ms: float = 0.0) -> None:
        self.frames.append((frame_ms, self.moving_scale))
        super().frame_ended(frame_ms, swap_ms)


def main(path: Path, fps: float) -> None:
    """Flies through a pack at `fps` frames per second."""
    pack, app = load_pack(path), App()
    with Window(app, (1100, 800)) as window:
        app.interface.page = ""
        app.show(pack, path)
        window.draw_frames(5)
        app.resolution = noting = Noting(fps)
        app.filming.path = flight(pack)
        app.filming.play(app)
        while app.filming.playing:
            window.step()
    ms, scales = np.array(noting.frames[10:]).T  # the first ones find the scale
    times = ms[scales < 1.0] * fps / 1000.0
    if not len(times):
        print(f"{len(ms)} frames, all of them with every pixel")
        return
    low, middle, high = np.percentile(times, (5, 50, 95))
    print(
        f"{len(times)} frames below full resolution, of the target of {1000 / fps:.1f} ms: median {middle:.2f}, mean "
        f"{times.mean():.2f}, 5 to 95 % {low:.2f} to {high:.2f}; {100 * (times > 1.1).mean():.1f} % more than a tenth late; "
        f"scales {scales.min():.2f} to {scales.max():.2f}"
    )


if __name__ == "__main__":
    path, fps = (*sys.argv[1:], "", "")[:2]
    main(Path(path or DEMO), float(fps or 30))
