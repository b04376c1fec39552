"""How a body on foot moves among boxes and planes. Lengths are in eye heights."""

from collections.abc import Callable

import numpy as np
import pytest

from viewer.features.camera.walking import JUMP_SPEED, RADIUS, STEP, Body, Space, moved

GRAIN = 0.06
FRAME_S = 1 / 30
Solid = Callable[[np.ndarray], np.ndarray]


def floor(p: np.ndarray) -> np.ndarray:
    return p[:, 1] <= 0


def box(low: tuple[float, ...], high: tuple[float, ...]) -> Solid:
    return lambda p: np.all((p >= low) & (p <= high), axis=1)


def space(*solids: Solid, grain: float = GRAIN) -> Space:
    return Space(lambda p: np.any([solid(p) for solid in solids], axis=0), grain)


def standing(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Body:
    return Body(np.array([x, y, z]), 0.0, True)


def walked(among: Space, body: Body, direction: tuple[float, float], seconds: float, frame_s=FRAME_S) -> Body:
    """Two eye heights a second towards (x, z)."""
    for _ in range(round(seconds / frame_s)):
        way = 2.0 * frame_s * np.array([direction[0], 0.0, direction[1]])
        body = moved(among, body, way, False, frame_s)
    return body


@pytest.mark.parametrize("grain", [GRAIN, 0.5])  # voxels of half its eye height, as in a small preview
def test_a_body_stands_still_on_the_floor_and_walks_level_at_its_speed(grain):
    among = space(floor, grain=grain)
    still = moved(among, standing(), np.zeros(3), False, FRAME_S)
    assert still.stands and np.array_equal(still.feet, [0, 0, 0])
    body = walked(among, standing(), (0.6, 0.8), 1.0)
    assert body.feet == pytest.approx([1.2, 0, 1.6], abs=1e-9) and body.stands


@pytest.mark.parametrize("degrees", [0, 20, 45, 200])
def test_a_wall_stops_it_and_it_slides_along(degrees):
    """A wall whose normal points in that direction, made of voxels."""
    turn = np.radians(degrees)
    normal, along = np.array([np.cos(turn), 0, np.sin(turn)]), np.array([-np.sin(turn), 0, np.cos(turn)])

    def wall(p: np.ndarray) -> np.ndarray:
        return (np.floor(p / GRAIN) + 0.5) * GRAIN @ normal < -0.5

    among = space(floor, wall)
    direct = walked(among, standing(), tuple(-normal[[0, 2]]), 1.0)
    assert abs(direct.feet @ normal + 0.5 - RADIUS) < 1.5 * GRAIN and abs(direct.feet @ along) < 4 * GRAIN
    slant = (along - normal) / np.sqrt(2)
    body = walked(among, standing(), tuple(slant[[0, 2]]), 2.0)
    assert body.feet @ normal > -0.5 and body.feet @ along > 1.7  # of 2.8


def test_in_a_corner_it_stops():
    among = space(floor, lambda p: p[:, 0] > 0.6, lambda p: p[:, 2] > 0.6)
    body = walked(among, standing(), (0.8, 0.6), 2.0)
    assert body.feet[[0, 2]] == pytest.approx([0.6 - RADIUS] * 2, abs=GRAIN)
    assert walked(among, body, (-1, 0), 0.5).feet[0] < -0.3  # and walks away again


@pytest.mark.parametrize(("height", "climbed"), [(0.15, True), (0.3, True), (0.45, False), (0.8, False)])
def test_it_climbs_steps_up_to_a_third_of_its_eye_height(height, climbed):
    among = space(floor, box((0.5, -1, -9), (9, height, 9)))
    body = walked(among, standing(), (1, 0), 1.0)
    assert (body.feet[0] > 1.5) == climbed == (height < STEP)
    assert body.feet[1] == pytest.approx(height if climbed else 0, abs=GRAIN / 4) and body.stands


def test_it_walks_down_stairs_without_falling_and_off_a_ledge_falls():
    def stairs(p: np.ndarray) -> np.ndarray:
        return p[:, 1] <= -0.2 * np.floor(np.clip(p[:, 0], 0, 2) / 0.4)

    body = standing(-0.3)
    for _ in range(46):
        body = moved(space(stairs), body, np.array([0.05, 0, 0]), False, FRAME_S)
        assert body.stands
    assert body.feet[1] < -0.7
    ledge = space(box((-9, -1, -9), (0, 0, 9)), lambda p: p[:, 1] <= -2)
    body = walked(ledge, standing(-0.3), (1, 0), 0.35)
    assert not body.stands and body.rising < 0
    assert walked(ledge, body, (0, 0), 1.5).feet[1] == pytest.approx(-2, abs=GRAIN / 4)


def test_it_jumps_once_and_a_ceiling_stops_the_jump():
    among = space(floor)
    body, top = moved(among, standing(), np.zeros(3), True, FRAME_S), 0.0
    for _ in range(60):
        top = max(top, body.feet[1])
        body = moved(among, body, np.zeros(3), False, FRAME_S)
    assert top == pytest.approx(JUMP_SPEED**2 / 12, abs=0.05) and body.stands and top > STEP
    low = space(floor, lambda p: p[:, 1] > 1.2)
    body = moved(low, standing(), np.zeros(3), True, 0.1)
    assert 0.05 < body.feet[1] < 0.15 and body.rising == 0


def test_where_there_is_no_room_for_its_head_it_does_not_climb():
    step, ceiling = box((0.5, -1, -9), (9, 0.25, 9)), box((0.5, 1.2, -9), (9, 3, 9))
    assert walked(space(floor, step), standing(), (1, 0), 1.0).feet[0] > 1.5
    body = walked(space(floor, step, ceiling), standing(), (1, 0), 1.0)
    assert body.feet[0] < 0.5 and body.feet[1] == 0


@pytest.mark.parametrize("frame_s", [0.1, 1.0, 5.0])
def test_long_frames_go_through_no_thin_wall_and_no_thin_floor(frame_s):
    thin_floor, thin_wall = box((-99, -GRAIN, -99), (99, 0, 99)), box((0.5, -1, -99), (0.5 + GRAIN, 9, 99))
    among = space(thin_floor, thin_wall)
    body = moved(among, standing(), np.array([2 * frame_s, 0, 0]), False, frame_s)
    assert body.feet[0] < 0.5 and body.feet[1] == pytest.approx(0, abs=1e-9)
    body = Body(np.array([0.0, 4.0, 0.0]), -9.0)
    for _ in range(60):
        body = moved(among, body, np.zeros(3), False, frame_s)
    assert body.stands and body.feet[1] == pytest.approx(0, abs=GRAIN / 2)


def test_a_body_that_is_stuck_is_lifted_out():
    body = walked(space(floor, box((-1, 0, -1), (1, 1.7, 1))), standing(), (0, 0), 1.0)
    assert body.feet[1] == pytest.approx(1.7, abs=GRAIN / 4) and body.stands
