"""How many pixels are drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenepack.pack import Pack
from tests.viewer.rendering.flights import flight
from viewer.core.pose import view_camera
from viewer.rendering.dynamic_resolution import HEADROOM, LATE, SMALLEST_SCALE, DynamicResolution, tiles
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

FULL = 1280 * 800  # pixels of the picture at scale 1


class Machine:
    """Takes known times: panels, swap and fixed (ms), and ms_at_full for all pixels of a picture at scale 1."""

    def __init__(self, ms_at_full: float, panels=0.0, swap=0.0, fixed=0.0, noise=0.0) -> None:
        self.ms_at_full, self.panels, self.swap, self.fixed = ms_at_full, panels, swap, fixed
        self.noise, self.random = noise, np.random.default_rng(0)

    def pixels_ms(self, resolution: DynamicResolution) -> float:
        return self.ms_at_full * resolution.moving_scale**2

    def work(self, resolution: DynamicResolution) -> float:
        return self.panels + self.swap + self.fixed + self.pixels_ms(resolution)

    def frame(self, resolution: DynamicResolution) -> float:
        """One frame while the camera moves; how long it took, ms."""
        uneven = 1.0 + self.noise * self.random.uniform(-1, 1)
        picture = (self.fixed + self.pixels_ms(resolution)) * uneven
        resolution.moved(picture, round(FULL * resolution.moving_scale**2))
        frame = self.panels + picture + self.swap
        resolution.frame_ended(frame, self.swap)
        return frame

    def run(self, resolution: DynamicResolution, frames: int = 150) -> None:
        for _ in range(frames):
            self.frame(resolution)


@given(st.integers(1, 700), st.integers(1, 700), st.integers(16, 300))
def test_tiles_cover_every_pixel_once(width, height, side):
    covered = np.zeros((height, width), int)
    for x, y, w, h in tiles(width, height, side):
        assert w > 0 and h > 0
        covered[y : y + h, x : x + w] += 1
    assert (covered == 1).all()


@given(st.floats(1.0, 1500.0), st.floats(10, 60), st.floats(0.0, 0.3), st.floats(0.0, 0.15), st.floats(0.0, 0.1))
def test_the_whole_frame_holds_the_target_and_no_pixels_are_given_away(ms_at_full, fps, panels, swap, fixed):
    resolution = DynamicResolution(target_fps=fps)
    target = resolution.target_ms
    machine = Machine(ms_at_full, panels * target, swap * target, fixed * target)
    machine.run(resolution)
    work = machine.work(resolution)
    assert work <= (LATE + 0.03) * target or resolution.scale == SMALLEST_SCALE
    assert work >= 0.8 * HEADROOM * target or resolution.scale in (1.0, SMALLEST_SCALE)


def test_the_scale_holds_still_while_times_waver():
    resolution = DynamicResolution(target_fps=30.0)
    machine = Machine(ms_at_full=150.0, panels=4.0, swap=3.0, noise=0.05)
    machine.run(resolution)
    scales = [(machine.frame(resolution), resolution.scale)[1] for _ in range(100)]
    assert max(scales) / min(scales) < 1.12 and (np.diff(scales) != 0).mean() < 0.3


def test_a_resolution_that_is_not_dynamic_draws_everything():
    resolution = DynamicResolution(enabled=False, rest_scale=0.5)
    Machine(900.0).run(resolution, 5)
    assert resolution.moving_scale == 0.5


# The adaptive resolution over a flight through a scene: a camera path is played, and each frame takes what its view costs

COUNTED = (24, 15)  # pixels of the picture whose rays are counted
SECONDS_APART = 0.05  # of the views that are counted; costs in between are on the line between two


@pytest.fixture(scope="module")
def costs(shapes: Pack, ctx) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) along the flight, and the mean cost of a ray there: samples fetched, and jumps at a third of one."""
    path, settings = flight(shapes), RenderSettings(counts=True)
    times = np.arange(0.0, path.duration + SECONDS_APART, SECONDS_APART)
    found = []
    with OffscreenRenderer(shapes, ctx=ctx) as renderer:
        for seconds in times:
            matrix, fov = path.at(float(seconds))
            counts = renderer.render_float(view_camera(matrix, fov, COUNTED), settings)
            found.append(float((counts[..., 0] + counts[..., 1] / 3.0).mean()))
    return times, np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("load", [3.0, 6.0])
@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_the_target_is_held_within_a_tenth_over_a_flight(costs, fps, load, noise):
    """load: frames' times that all pixels of a middling view take. Where every pixel is drawn, frames may be quicker."""
    times, counted = costs
    assert counted.max() > 8 * counted.min()  # there is something to follow
    resolution = DynamicResolution(target_fps=fps)
    target = resolution.target_ms
    ms = counted / counted.mean() * load * target
    machine, now = Machine(0.0, 0.15 * target, fixed=0.05 * target, noise=noise), 0.0
    spent, drawn = [], []
    while now < times[-1]:
        machine.ms_at_full = float(np.interp(now, times, ms))
        drawn.append(resolution.moving_scale)
        spent.append(machine.frame(resolution))
        now += spent[-1] / 1000.0
    frames, scales = np.array(spent), np.array(drawn)
    used = frames[scales < 1.0] / target
    assert len(used) > 100 and scales.min() > SMALLEST_SCALE and scales.max() > 3 * scales.min()
    assert abs(used.mean() - HEADROOM) < 0.02  # what is planned for: a tenth below the target
    assert (used > 1.1).mean() <= 0.01 and used.max() < 1.2
    assert (used < 0.75).mean() <= 0.04  # nor are pixels given away
