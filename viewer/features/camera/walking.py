"""Walking: the camera stands on the ground, at eye height, and walls stop it.

Space is solid where the opacity that is drawn reaches SOLID, and below the bottom of the content's box, whose sides the body does
not leave either: what lies beyond the inner cube of a contracted pack is too coarse to walk on.

Notation of the body: lengths in eye heights, y up; time in seconds. feet: float64 [3], below the middle of the body. The body is
an upright cylinder of RADIUS, tested at points from STEP above its feet to TOP: whatever is lower is stepped on. grain: the side
of a voxel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil, floor
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from console import UserError
from scenepack.pack import Pack
from viewer.core.annotations import METRES, Scale
from viewer.features.camera.orbit_camera import OrbitCamera
from viewer.features.measuring.surface import opacities, surface_at
from viewer.features.photographs.photographs import shots_of
from viewer.rendering.camera import ViewCamera
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.settings import RenderSettings

if TYPE_CHECKING:
    from viewer.app.application import App

USUAL_M = 1.6  # eye height
EYE_HEIGHTS = (0.3, 3.0)  # m, the least and the most
SCENE_M = 64.0  # side of a scene of unknown scale
SOLID = 0.3  # opacity
SPEEDS = (0.2, 10.0)  # eye heights per second
AHEAD = 3.0  # eye heights: where the pivot lies when the walk is over
FARTHEST_BACK, LOWEST = 5.0, 4.0  # eye heights: from the surface before which the walk begins, and below it
EYE = np.array([0.0, 1.0, 0.0])  # above the feet
SLOPING = 0.5  # a face of the box is a side if less of its normal than this points up or down


@dataclass
class Walking:
    """eye_height_m: in scenes without a scale, metres are a guess. speed: eye heights per second. stands: on the ground."""

    eye_height_m: float = USUAL_M
    speed: float = 2.0
    stands: bool = False
    _metre: float = 1.0  # grid units
    _rising: float = 0.0

    @property
    def eye_height(self) -> float:
        """Grid units."""
        return self.eye_height_m * self._metre

    def toggle(self, app: App) -> None:
        """Begins to walk where the camera is; from outside of the scene, before what it sees in the middle of the picture.

        UserError for forward-facing scenes.
        """
        rig, pack, camera = app.open_scene.rig, app.open_scene.pack, app.camera()
        if rig.bounded:
            raise UserError("a forward-facing scene has no ground to walk on")
        if rig.walking:
            rig.navigate("orbit")
            app.messages.say("Orbiting the pivot")
            return
        self._metre = metre_of(pack, rig, app.annotations.current.scale)
        self._rising, self.stands = 0.0, False
        rig.set_orthographic(False)  # remembers this moment
        eye, up, (low, high) = rig.goal.eye(rig.table), rig.table.axes[1], rig.all_of_it
        pose = replace(rig.goal, distance=AHEAD * self.eye_height)
        above = 2 * self.eye_height * up
        if np.any((eye < low + np.minimum(above, 0.0)) | (eye > high + np.maximum(above, 0.0))):
            eye, pose = self._before(pack, rig, camera, app.settings), replace(pose, elevation=0.0)
        rig.navigate("walk")
        rig.stand_at(eye, pose)
        keys = app.keyboard.flying_names
        app.messages.say(f"Walking: {' '.join(keys[:4])} or the arrows, {keys[5]} to jump; drag to look")

    def _before(self, pack: Pack, rig: OrbitCamera, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """Where the eye begins: before what is seen in the middle of the picture, on the lowest ground, and not on its roof."""
        hit = surface_at(pack, camera, settings, 0.5 * camera.width, 0.5 * camera.height)
        local_R_grid, space = np.stack(rig.table.axes), _space(pack, settings, rig, self.eye_height)
        at = local_R_grid @ (rig.middle if hit is None else hit.point) / self.eye_height
        back = local_R_grid @ rig.table.rotation(rig.goal.azimuth, 0.0)[:, 2]
        places = [at + distance * back for distance in np.arange(2 * RADIUS, FARTHEST_BACK, 2 * RADIUS)]
        grounds = [(place, space.ground(place, LOWEST)) for place in places]
        stands = [np.array([x, y, z]) for (x, _, z), y in grounds if y is not None]
        feet = min(filter(space.is_free, stands), key=lambda feet: feet[1], default=places[0])
        return self.eye_height * (feet + EYE) @ local_R_grid

    def faster(self, notches: float) -> float:
        """Changes the speed, by a fifth per notch; grid units per second."""
        self.speed = float(np.clip(self.speed * 1.2**notches, *SPEEDS))
        return self.speed * self.eye_height

    def tick(self, app: App, seconds: float) -> None:
        """Moves the body as keys and gravity want it."""
        if app.scene is None or not app.scene.rig.walking:
            return
        rig, eye_height = app.scene.rig, self.eye_height
        local_R_grid, (low, high) = np.stack(rig.table.axes), rig.all_of_it
        right, up, forward = rig.take_steps()
        axes = rig.table.rotation(rig.goal.azimuth, 0.0)
        way = self.speed * (local_R_grid @ (right * axes[:, 0] - forward * axes[:, 2]))
        before = local_R_grid @ rig.goal.eye(rig.table) / eye_height
        body = Body(before - EYE, self._rising, self.stands)
        body = moved(_space(app.scene.pack, app.settings, rig, eye_height), body, way, up > 0, seconds)
        self._rising, self.stands = body.rising, body.stands
        eye = eye_height * (body.feet + EYE) @ local_R_grid
        is_side, margin = np.abs(rig.table.axes[1]) < SLOPING, RADIUS * eye_height
        eye = np.where(is_side, np.clip(eye, np.minimum(low + margin, high), np.maximum(high - margin, low)), eye)
        if np.abs(local_R_grid @ eye / eye_height - before).max() > 1e-6:
            rig.stand_at(eye)
            app.touch()


def _space(pack: Pack, settings: RenderSettings, rig: OrbitCamera, eye_height: float) -> Space:
    """What is solid in the frame of the body: axes of the placed frame, y up, and lengths in eye heights."""
    grid_T_local, up, (bottom, top) = eye_height * np.stack(rig.table.axes), rig.table.axes[1], rig.all_of_it
    low, high = RayFrame(pack).box(replace(settings, surroundings=False))

    def is_solid(points: np.ndarray) -> np.ndarray:
        grid = points @ grid_T_local
        places = (grid - pack.min_xyz) / pack.voxel_size
        drawn = np.all((places >= low) & (places <= high), axis=1)
        below = ((up > SLOPING) & (grid < bottom)) | ((up < -SLOPING) & (grid > top))
        return below.any(axis=1) | (drawn & (opacities(pack, places) >= SOLID))

    return Space(is_solid, pack.voxel_size / eye_height)


def metre_of(pack: Pack, rig: OrbitCamera, scale: Scale) -> float:
    """Grid units in a metre, by the scale of the scene if its longest side is more than two eye heights then.

    Otherwise a guess: in a scene that was photographed from inside, the photographs' median height is eye height; any other scene
    is SCENE_M long.
    """
    low, high = rig.all_of_it
    side = float((high - low).max())
    if scale.unit in METRES:
        metre = 1.0 / (scale.factor * METRES[scale.unit])
        if 2 * USUAL_M * metre < side:
            return metre
    if rig.within:
        eyes = np.array([shot.view.position for shot in shots_of(pack)] or [rig.home_pose.eye(rig.table)])
        down = np.arange(0.0, side, 0.5 * pack.voxel_size)
        places = eyes[:, None] - down[:, None] * rig.table.axes[1]
        solid = opacities(pack, ((places - pack.min_xyz) / pack.voxel_size).reshape(-1, 3)) >= SOLID
        heights = down[np.argmax(solid.reshape(len(eyes), -1), axis=1)]  # 0 where there is no ground
        if (height := float(np.median(heights))) > 0.01 * side:
            return height / USUAL_M
    return side / SCENE_M


# --- The body ---

RADIUS, STEP, TOP = 0.15, 1 / 3, 1.06
GRAVITY, JUMP_SPEED, FASTEST_FALL = 6.0, 2.3, 15.0  # eye heights per s², and per s; a jump is 0.44 high
ASIDE = (0.0, 0.5, 1.0)  # voxels away from a wall, along which the body may have to go past its bumps


def _disc(*radii: float) -> np.ndarray:
    """Points on level circles around the axis, and on it; float64 [n, 3]."""
    angles = 2 * np.pi * np.arange(12) / 12
    circle = np.stack([np.cos(angles), np.zeros(12), np.sin(angles)], axis=1)
    return np.concatenate([np.zeros((1, 3)), *(radius * circle for radius in radii)])


def _upright(disc: np.ndarray, heights: int) -> np.ndarray:
    return (disc + np.linspace(STEP, TOP, heights)[:, None, None] * np.array([0.0, 1.0, 0.0])).reshape(-1, 3)


SOLES = _disc(RADIUS)
BODY = _upright(SOLES, 8)
NEAR = _upright(_disc(*(RADIUS * np.array([0.4, 0.8, 1.2, 1.6]))), 5)  # of which the solid ones tell where a wall is


class Body(NamedTuple):
    """rising: speed upwards. stands: there is ground below its feet."""

    feet: np.ndarray
    rising: float = 0.0
    stands: bool = False


class Space(NamedTuple):
    """is_solid: of points float64 [n, 3], bool [n]."""

    is_solid: Callable[[np.ndarray], np.ndarray]
    grain: float

    def is_free(self, feet: np.ndarray) -> bool:
        return not self.is_solid(feet + BODY).any()

    def swept(self, feet: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, bool]:
        """How far the body gets, and whether that is all of the way. No wall of a voxel's thickness is missed."""
        count = max(1, ceil(float(np.linalg.norm(way)) / (0.5 * self.grain)))
        places = feet + way * (np.arange(1, count + 1) / count)[:, None]
        hit = self.is_solid((places[:, None] + BODY).reshape(-1, 3)).reshape(count, -1).any(axis=1)
        if not hit.any():
            return feet + way, True
        first = int(np.argmax(hit))
        return (places[first - 1] if first else feet), False

    def ground(self, feet: np.ndarray, reach: float) -> float | None:
        """Height of the highest ground from STEP above the feet to `reach` below them. Heights are multiples of one spacing."""
        spacing = min(0.5 * self.grain, max(self.grain / 8, 0.005))
        top, bottom = floor((feet[1] + STEP) / spacing + 1e-6), ceil((feet[1] - reach) / spacing - 1e-6)
        heights = spacing * np.arange(top, bottom - 1, -1)
        columns = np.repeat((feet + SOLES)[None], len(heights), axis=0)
        columns[..., 1] = heights[:, None]
        found = self.is_solid(columns.reshape(-1, 3)).reshape(len(heights), -1).any(axis=1)
        return float(heights[np.argmax(found)]) if found.any() else None

    def wall_normal(self, feet: np.ndarray) -> np.ndarray | None:
        """Level unit vector away from what is solid near the body; None where that is on all sides, or nothing."""
        normal = -NEAR[self.is_solid(feet + NEAR)].sum(axis=0) * [1.0, 0.0, 1.0]
        size = float(np.linalg.norm(normal))
        return normal / size if size > 1e-6 else None


def moved(space: Space, body: Body, way: np.ndarray, jumps: bool, seconds: float) -> Body:
    """The body after `seconds`, in which it wants to walk `way` (float [3], level)."""
    feet, rising, stands = body
    if jumps and stands:
        rising, stands = JUMP_SPEED, False
    pieces = max(1, ceil(float(np.linalg.norm(way)) / RADIUS))
    for _ in range(pieces):
        if rising > 0:
            feet = _slid(space, feet, way / pieces)
        else:
            feet, stands = _walked(space, feet, way / pieces, STEP if stands else 0.0)
    if stands:
        return Body(feet, 0.0, True)
    rising = max(rising - GRAVITY * seconds, -FASTEST_FALL)
    if rising > 0:
        feet, clear = space.swept(feet, np.array([0.0, rising * seconds, 0.0]))
        return Body(feet, rising if clear else 0.0)
    ground = space.ground(feet, -rising * seconds)
    if ground is not None:
        return Body(_at_height(feet, ground), 0.0, True)
    return Body(_at_height(feet, feet[1] + rising * seconds), rising)


def _walked(space: Space, feet: np.ndarray, way: np.ndarray, reach: float) -> tuple[np.ndarray, bool]:
    """The feet after a way not longer than RADIUS, on the ground that is at most `reach` below; and whether there is some.

    A body that is stuck moves as if nothing were there, and is lifted out.
    """
    stuck = not space.is_free(feet)
    there = feet + way if stuck else _slid(space, feet, way)
    ground = space.ground(there, reach)
    if ground is None:
        return there, False
    lifted = _at_height(there, ground)
    if ground > feet[1] and not stuck and not space.is_free(lifted):  # the ceiling is too low
        return feet, space.ground(feet, reach) is not None
    return lifted, True


def _slid(space: Space, feet: np.ndarray, way: np.ndarray) -> np.ndarray:
    """As far as the walls let the body go, and on along them."""
    end = feet + way
    feet, clear = space.swept(feet, way)
    normal = None if clear else space.wall_normal(feet)
    if clear or normal is None:
        return feet
    along = end - feet
    along = along - min(float(along @ normal), 0.0) * normal
    for voxels in ASIDE:
        beside, _ = space.swept(feet, voxels * space.grain * normal)
        reached, clear = space.swept(beside, along)
        if clear:
            return reached
    return feet


def _at_height(feet: np.ndarray, height: float) -> np.ndarray:
    return np.array([feet[0], height, feet[2]])
