"""Walking: the camera stands on the ground, at eye height, and walls stop it (walk_physics).

Space is solid where the opacity that is drawn reaches SOLID, and below the bottom of the content's box, whose sides the body does
not leave either: what lies beyond the inner cube of a contracted pack is too coarse to walk on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from console import UserError
from scenepack.pack import Pack
from viewer.core.annotations import METRES, Scale
from viewer.features.camera.orbit_camera import OrbitCamera
from viewer.features.camera.walk_physics import RADIUS, Body, Space, moved
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
        camera = app.camera()
        if app.scene is None or camera is None:
            return
        rig, pack = app.scene.rig, app.scene.pack
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
