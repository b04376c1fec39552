"""Orbit camera: turntable, pan, dolly, fly and walk, with damping and undo.

`goal` is where the user wants the camera, `shown` follows it smoothly. `held` is an exact camera (of a photograph or a keyframe)
that is shown instead until the user moves. Mouse distances are in units of the picture's height, y down, so that behaviour does
not depend on resolution. Cursor positions are (x, y) in -1 … 1, y up, x scaled by aspect.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, log, radians, tan
from typing import Any, Literal

import numpy as np

from scenepack.pack import Pack
from scenepack.placement import Rows, placement_of
from viewer.core.pose import STEEP, History, Pose, Turntable, fitted, shortest_turn, triple
from viewer.features.photographs.photographs import shots_of
from viewer.rendering.camera import ViewCamera, content_box, filling_distance, is_mirrored, middle_of, outline

DEFAULT_FOV = 35.0  # degrees, vertical; the published viewer's
FOVS = (5.0, 150.0)  # the least and the most, degrees
TURN_PER_HEIGHT = 200.0  # degrees for a drag over the picture's whole height
DOLLY_STEP = 0.9  # of the distance, per notch of the wheel
SETTLE_S = 0.07  # time constant of the damping
MARGIN_WITHIN = 0.1  # of the content's diagonal: cameras this far outside the content still count as within
WALKING_FOV = 60.0  # degrees, the least: with less, nothing is seen of where one goes
HOME_ANGLES = (205.0, 22.0)  # azimuth, elevation in degrees; from -z as in the published viewer, a little aside

Navigation = Literal["orbit", "fly", "walk"]  # what keys and mouse do


class OrbitCamera:
    bounded = False  # forward-facing packs are only seen from about where they were photographed

    def __init__(self, pack: Pack, fov: float = DEFAULT_FOV) -> None:
        self.table = Turntable(mirrored=is_mirrored(pack), placed=placement_of(pack).rotation)
        self.all_of_it = content_box(pack)
        self._outline = outline(pack)
        self.middle = middle_of(self._outline)
        self.radius = max(float(np.linalg.norm(self._outline - self.middle, axis=1).max()), 1e-6)
        self.distances = 1e-3 * self.radius, 20.0 * self.radius  # of the camera from the pivot, the least and the most
        self.home_fov = self.fov = fov
        self.navigation: Navigation = "orbit"
        self._steps = np.zeros(3)  # walking: see take_steps
        self._fov_before_walk = fov
        self.orthographic = False
        self.speed = 0.5 * self.radius  # grid units per second
        self.aspect = 1.0  # width over height of the picture that the scene shall fit into
        self._view = None if self.bounded else view_from_within(pack)
        if self._view is not None:
            self.home_fov = self.fov = self._view.fov
        self.within = self._view is not None  # the first view is one from amid the scene, and need not show all of it
        self.home_pose = self._home()
        self.goal = self.shown = self.home_pose
        self.held: ViewCamera | None = None
        self.history = History()
        self.history.follow(self._state, self._return)

    def _pose_of(self, grid_T_camera: np.ndarray) -> Pose:
        return Pose.from_matrix(grid_T_camera, self._distance_to_middle(grid_T_camera), self.table)

    def _home(self) -> Pose:
        if self._view is not None:
            return self._pose_of(self._view.grid_T_camera)
        return Pose(triple(self.middle), *HOME_ANGLES, self.framing_distance(*HOME_ANGLES, self.home_fov))

    def framing_distance(self, azimuth: float, elevation: float, fov: float) -> float:
        """From where all of the scene just fits into the picture's height and width; all three angles in degrees."""
        local = (self._outline - self.middle) @ self.table.rotation(azimuth, elevation)
        return filling_distance(local, fov, self.aspect, orthographic=self.orthographic)

    def shape(self, aspect: float) -> None:
        """The picture has another shape (width over height). A first view that was not left follows it."""
        if aspect == self.aspect:
            return
        self.aspect = aspect
        if self.bounded or self.within:
            return
        before, self.home_pose = self.home_pose, self._home()
        if self.goal == before and self.held is None and self.fov == self.home_fov:
            self.shown = self.home_pose if self.shown == before else self.shown
            self.goal = self.home_pose

    @property
    def flying(self) -> bool:
        return self.navigation == "fly"

    @property
    def walking(self) -> bool:
        return self.navigation == "walk"

    @property
    def looks_around(self) -> bool:
        """Whether the camera turns where it stands, and keys move it, as in flying and walking."""
        return self.navigation != "orbit"

    # The present camera

    def camera(self, size: tuple[int, int], near: float = 0.0) -> ViewCamera:
        """The camera of this moment for a picture of `size` (width, height, pixels). near: that of the settings, grid units."""
        if self.held is not None:
            return fitted(self.held, size)
        camera = ViewCamera.posed(self.shown.matrix(self.table), self.fov, size)
        return self._parallel(camera, near) if self.orthographic else camera

    def _parallel(self, camera: ViewCamera, near: float) -> ViewCamera:
        """The orthographic view with the same height at the pivot, from before all there is; a near plane stays where it is."""
        back, pivot = camera.grid_T_camera[:3, 2], np.asarray(self.shown.pivot)
        low, high = self.all_of_it
        reach = float((0.5 * (low + high) - pivot) @ back) + 0.51 * float(np.linalg.norm(high - low))
        if near > 0:  # the renderer counts it from the camera, and takes no less than the settings have
            reach = max(reach, self.shown.distance)
            near += reach - self.shown.distance
        matrix = camera.grid_T_camera.copy()
        matrix[:3, 3] = pivot + reach * back
        return replace(camera, grid_T_camera=matrix, near=near).as_orthographic(self.ortho_height)

    @property
    def ortho_height(self) -> float:
        """Grid units that the picture shows at the pivot, from top to bottom."""
        return 2.0 * self.shown.distance * tan(radians(self.fov) / 2)

    @property
    def seen_fov(self) -> float:
        """Vertical field of view of this moment, degrees."""
        return self.held.fov if self.held is not None else self.fov

    @property
    def matrix(self) -> np.ndarray:
        """grid_T_camera of this moment, float64 [4, 4]."""
        return self.held.grid_T_camera if self.held is not None else self.shown.matrix(self.table)

    def update(self, seconds: float) -> bool:
        """Lets `shown` follow `goal` for `seconds`; True while it has not arrived."""
        if self.shown == self.goal:
            return False
        share = 1.0 - exp(-seconds / SETTLE_S)
        shown, goal = self.shown, self.goal
        azimuth = shown.azimuth + share * shortest_turn(shown.azimuth, goal.azimuth)
        elevation = shown.elevation + share * (goal.elevation - shown.elevation)
        distance = exp(log(shown.distance) + share * log(goal.distance / shown.distance))
        pose = Pose(shown.pivot, azimuth, elevation, distance)
        eye, pivot = shown.eye(self.table), np.asarray(shown.pivot)
        eye_way, pivot_way = goal.eye(self.table) - eye, np.asarray(goal.pivot) - pivot
        # Of eye and pivot, the one that moves less keeps to a straight line: looking around, the eye; orbiting, the pivot.
        if not self.bounded and np.linalg.norm(eye_way) < np.linalg.norm(pivot_way):
            pose = pose.seen_from(eye + share * eye_way, self.table)
        else:
            pose = replace(pose, pivot=triple(pivot + share * pivot_way))
        off = np.linalg.norm(pose.eye(self.table) - goal.eye(self.table)) / goal.distance
        angles_off = max(abs(shortest_turn(pose.azimuth, goal.azimuth)), abs(pose.elevation - goal.elevation))
        self.shown = goal if off < 2e-4 and angles_off < 0.02 else pose
        return True

    # Gestures

    def take_over(self) -> None:
        """Leaves a held camera, from exactly there (but level): the next movement starts from what is seen."""
        if self.held is not None:
            seen = 0.5 * max(self.held.height, self.held.width / self.aspect) / self.held.fy  # see fitted()
            self.fov = float(np.clip(np.degrees(2.0 * np.arctan(seen)), *FOVS))
            self._let_go()

    def _let_go(self) -> None:
        if self.held is not None:
            self.goal = self.shown = self._bounded(self._pose_of(self.held.grid_T_camera))
            self.held = None

    def orbit(self, dx: float, dy: float) -> None:
        """Turns about the pivot, or where the camera stands when it looks around."""
        self.take_over()
        dx = dx if self.table.mirrored else -dx
        if self.looks_around:
            self.stand_at(self.goal.eye(self.table), self._turned(0.6 * dx, 0.6 * dy))
        else:
            self.goal = self._turned(dx, dy)

    def _turned(self, dx: float, dy: float) -> Pose:
        return self.goal.aimed(self.goal.azimuth + TURN_PER_HEIGHT * dx, self.goal.elevation + TURN_PER_HEIGHT * dy)

    def pan(self, dx: float, dy: float) -> None:
        """Slides parallel to the picture, so that what lies at the pivot's depth stays under the cursor."""
        self.take_over()
        height = 2.0 * self.goal.distance * tan(radians(self.fov) / 2)
        self._shift(height * self.goal.rotation(self.table) @ (-dx, dy, 0.0))

    def _shift(self, by: np.ndarray) -> None:
        self.goal = self._bounded(replace(self.goal, pivot=triple(np.asarray(self.goal.pivot) + by)))

    def dolly(self, notches: float, cursor: tuple[float, float] = (0.0, 0.0)) -> None:
        """Moves towards (notches > 0) what lies under the cursor at the pivot's depth, or away from it."""
        self.take_over()
        distance = float(np.clip(self.goal.distance * DOLLY_STEP**notches, *self.distances))
        closer = (self.goal.distance - distance) * tan(radians(self.fov) / 2)
        shift = closer * self.goal.rotation(self.table) @ (*cursor, 0.0)
        self.goal = replace(self.goal, distance=distance)
        self._shift(shift)

    def fly(self, right: float, up: float, forward: float, seconds: float) -> None:
        """Moves for `seconds` at the rig's speed; the three are -1 … 1 along the camera's axes. Walking: see take_steps."""
        self.take_over()
        if self.walking:
            self._steps += seconds * np.array([right, up, forward])
            return
        self._shift(self.speed * seconds * self.goal.rotation(self.table) @ (right, up, -forward))

    def faster(self, notches: float) -> float:
        """Changes the flying speed, by a fifth per notch; the new one."""
        self.speed = float(np.clip(self.speed * 1.2**notches, 1e-3 * self.radius, 10.0 * self.radius))
        return self.speed

    def navigate(self, how: Navigation) -> None:
        """Keys and mouse do this from now on. Walking has a wide field of view, and gives the former one back."""
        if how == "walk":
            self._fov_before_walk, self.fov = self.fov, max(self.fov, WALKING_FOV)
        elif self.walking and self.fov == WALKING_FOV:
            self.fov = self._fov_before_walk
        self.navigation = how
        self._steps = np.zeros(3)

    def stop_walking(self) -> None:
        """Orbits again, because the camera leaves the ground that it walks on."""
        if self.walking:
            self.navigate("orbit")

    def take_steps(self) -> np.ndarray:
        """What fly() asked for since the last time: right, up, forward, each times its seconds."""
        steps, self._steps = self._steps, np.zeros(3)
        return steps

    def stand_at(self, eye: np.ndarray, pose: Pose | None = None) -> None:
        """Goes to `eye` (float [3], grid frame) with the angles it has, or with those of `pose`."""
        self.goal = (pose or self.goal).seen_from(eye, self.table)

    def grown(self, finer: OrbitCamera) -> OrbitCamera:
        """The rig for a finer version of the same scene: `finer`, or this one if somebody has moved the camera already."""
        if self.goal == self.home_pose and self.held is None and self.fov == self.home_fov and self.history.empty:
            return finer
        self.follow(finer)
        return self

    def follow(self, finer: OrbitCamera) -> None:
        """Takes over what `finer` knows of another version of the scene; the camera stays where it is."""
        self.middle, self.radius, self._outline = finer.middle, finer.radius, finer._outline
        self.all_of_it, self.distances = finer.all_of_it, finer.distances
        self.home_pose, self.within = finer.home_pose, finer.within

    # Commands

    def go(self, pose: Pose) -> None:
        """Glides there; remember() beforehand."""
        self.stop_walking()
        self._let_go()
        self.goal = self._bounded(pose)

    def home(self) -> None:
        self.remember()
        self.stop_walking()
        self.fov, self.orthographic = self.home_fov, False
        self.go(self.home_pose)

    def frame(self) -> None:
        """Shows the whole scene, from where the camera looks now."""
        self.remember()
        self.stop_walking()
        distance = self.framing_distance(self.goal.azimuth, self.goal.elevation, self.fov)
        self.go(replace(self.goal, pivot=triple(self.middle), distance=distance))

    def begin_at(self, pose: Pose) -> None:
        """The first view is this one, whatever the picture's shape."""
        self.within = True
        self.home_fov = self.fov = DEFAULT_FOV
        self.home_pose = self.goal = self.shown = pose

    def look_along(self, azimuth: float, elevation: float) -> None:
        """An axis view; degrees."""
        self.remember()
        self.go(self.goal.aimed(azimuth, elevation))

    def look_from(self, axis: np.ndarray) -> None:
        """Looks from the side that `axis` (float [3], grid frame) points to; from the other one where it does so already."""
        for direction in (np.asarray(axis, np.float64), -np.asarray(axis, np.float64)):
            azimuth, elevation = self.table.angles(direction)
            azimuth = 0.0 if abs(elevation) > STEEP else azimuth
            off = max(abs(shortest_turn(self.goal.azimuth, azimuth)), abs(self.goal.elevation - elevation))
            if off > 0.01 or self.held is not None:
                break
        self.look_along(azimuth, elevation)

    def turn(self, azimuth: float, elevation: float) -> None:
        """Turns about the pivot by so many degrees, smoothly."""
        self.look_along(self.goal.azimuth + azimuth, self.goal.elevation + elevation)

    def set_orthographic(self, orthographic: bool) -> None:
        """With parallel rays, or with perspective; what lies at the pivot keeps its size."""
        self.remember()
        self.take_over()
        self.orthographic = orthographic
        if orthographic:
            self.navigate("orbit")

    def set_pivot(self, point: np.ndarray) -> None:
        """Turns to look at `point` (float [3], grid frame) from where the camera is, and orbits it from now on."""
        self.remember()
        self.take_over()
        eye = self.goal.eye(self.table)
        back = eye - np.asarray(point, np.float64)
        if not back.any():
            return
        pose = replace(self.goal, pivot=triple(point))
        if not self.orthographic:  # there, turning would show another side, and the distance tells the size
            azimuth, elevation = self.table.angles(back)
            azimuth = pose.azimuth if abs(elevation) > STEEP else azimuth
            pose = Pose(pose.pivot, azimuth, elevation, float(np.linalg.norm(back)))
        self.goal = self._bounded(pose)

    def set_up(self, up: str) -> None:
        """Another axis points up from now on; the camera keeps its place and is levelled."""
        self.remember()
        self._level(replace(self.table, up=up))

    def place(self, placed: Rows) -> None:
        """The placed frame has these axes from now on; the camera keeps its place and is levelled. remember() beforehand."""
        if not self.bounded and placed != self.table.placed:
            self._level(replace(self.table, placed=placed))
            self.home_pose = self._home()

    def begin_placed(self, placed: Rows) -> None:
        """As place(), before anybody has moved the camera: the first view becomes that of the placed frame."""
        if not self.bounded and placed != self.table.placed:
            self.table = replace(self.table, placed=placed)
            self.home_pose = self.goal = self.shown = self._home()

    def _level(self, table: Turntable) -> None:
        matrix, distance = self.matrix, self.goal.distance
        self.held, self.table = None, table
        self.goal = self.shown = Pose.from_matrix(matrix, distance, table)

    def set_matrix(self, grid_T_camera: np.ndarray, fov: float | None, ortho_height: float | None = None) -> None:
        """Goes to a camera at once; roll is lost. ortho_height: of an orthographic view; None for perspective."""
        self.remember()
        self.stop_walking()
        self.held = None
        if fov is not None:
            self.fov = fov
        self.orthographic = ortho_height is not None and not self.bounded
        pose = self._pose_of(grid_T_camera)
        if ortho_height is not None and self.orthographic:
            distance = ortho_height / (2.0 * tan(radians(self.fov) / 2))
            pose = replace(pose, distance=distance).seen_from(grid_T_camera[:3, 3], self.table)
        self.goal = self.shown = self._bounded(pose)

    def stand_as(self, other: OrbitCamera) -> None:
        """Looks at once from where `other` does, a rig in another version of the scene."""
        self.remember()
        self.stop_walking()
        self.held, self.fov = None, other.fov
        self.goal = self.shown = self._bounded(other.goal)

    def hold(self, camera: ViewCamera) -> None:
        """Shows exactly `camera` until the next movement; remember() beforehand."""
        self.stop_walking()
        self.held = camera

    def _distance_to_middle(self, grid_T_camera: np.ndarray) -> float:
        """How far ahead of the camera the scene's middle lies: a good distance to turn about."""
        ahead = float((self.middle - grid_T_camera[:3, 3]) @ -grid_T_camera[:3, 2])
        return float(np.clip(ahead, 0.2 * self.radius, 20.0 * self.radius))

    def _bounded(self, pose: Pose) -> Pose:
        return pose

    # Undo

    def remember(self) -> None:
        """Marks the present camera as a place to come back to; call before each gesture."""
        self.history.remember()

    def _state(self) -> tuple[Any, ...]:
        return self.goal, self.held, self.fov, self.table, self.orthographic, self.walking

    def _return(self, state: tuple[Any, ...]) -> None:
        before = self.table
        self.goal, self.held, self.fov, self.table, self.orthographic, walked = state
        if self.table != before:  # there is no way to glide from one up to another
            self.shown = self.goal
        if self.table.placed != before.placed:
            self.home_pose = self._home()
        if not walked:
            self.navigation = "orbit" if self.walking else self.navigation


def view_from_within(pack: Pack) -> ViewCamera | None:
    """The most central training photograph of a scene that surrounds most of its cameras, such as a room; None for others."""
    views = [shot.view for shot in shots_of(pack) if shot.split == "train"]
    if not views:
        return None
    low, high = content_box(pack)
    margin = MARGIN_WITHIN * np.linalg.norm(high - low)
    eyes = np.array([view.position for view in views])
    within = np.all((eyes > low - margin) & (eyes < high + margin), axis=1).mean() >= 0.5
    if pack.contraction is None and not within:
        return None
    backs = np.array([view.grid_T_camera[:3, 2] for view in views])
    spread = max(float(np.linalg.norm(eyes - eyes.mean(0), axis=1).mean()), 1e-9)
    distance = np.linalg.norm(eyes - np.median(eyes, axis=0), axis=1) / spread
    turned = np.linalg.norm(backs - np.median(backs, axis=0), axis=1)
    return views[int(np.argmin(distance + turned))]
