"""The camera of forward-facing (NDC) packs: it slides in front of the scene and cannot walk around it.

As in the published viewer, the camera starts 0.25 units behind the photographs' mean position, dollies between 0.05 and
0.3, and the left button pans. We keep it near where photographs were taken, and let the right button turn a little.
"""

from dataclasses import replace
from math import atan, degrees, radians, tan

import numpy as np

from console import UserError
from scenepack.exports.field import ndc_camera
from scenepack.pack import Pack
from viewer.core.pose import Pose, shortest_turn
from viewer.features.camera.orbit_camera import OrbitCamera

AHEAD = 180.0  # azimuth: the grid frame's z is mirrored, so the scene lies towards +z
START_DISTANCE = 0.25
DISTANCES = (0.05, 0.3)
PAN_LIMIT = 0.4  # units of the photographs' frame, from their mean position
TURN_LIMIT = 20.0  # degrees
PAN_PER_HEIGHT = 1.2  # units for a drag over the whole height at the start distance; content is far behind the pivot


class ForwardFacingCamera(OrbitCamera):
    bounded = True

    def __init__(self, pack: Pack) -> None:
        _, height, focal = ndc_camera(pack)
        super().__init__(pack, fov=degrees(2.0 * atan(0.5 * height / focal)))  # that of the photographs
        self.middle, self.radius = np.zeros(3), 1.0  # the content box is in warped space, of no use here
        self.speed, self.distances = 0.1, DISTANCES

    def _home(self) -> Pose:
        return Pose((0.0, 0.0, 0.0), AHEAD, 0.0, START_DISTANCE)

    def _bounded(self, pose: Pose) -> Pose:
        x, y, _ = (float(np.clip(v, -PAN_LIMIT, PAN_LIMIT)) for v in pose.pivot)
        turn = float(np.clip(shortest_turn(AHEAD, pose.azimuth), -TURN_LIMIT, TURN_LIMIT))
        elevation = float(np.clip(pose.elevation, -TURN_LIMIT, TURN_LIMIT))
        return Pose((x, y, 0.0), AHEAD + turn, elevation, float(np.clip(pose.distance, *DISTANCES)))

    def _distance_to_middle(self, grid_T_camera: np.ndarray) -> float:
        return START_DISTANCE

    def orbit(self, dx: float, dy: float) -> None:
        """Turns, within the bounds, about a point just ahead."""
        self.take_over()
        self.goal = self._bounded(self._turned(0.3 * dx, 0.3 * dy))

    def pan(self, dx: float, dy: float) -> None:
        """Slides parallel to the photographs' plane, within the bounds."""
        self.take_over()
        scale = PAN_PER_HEIGHT * tan(radians(self.fov) / 2) * self.goal.distance / START_DISTANCE
        self._shift(scale * self.table.rotation(AHEAD, 0.0) @ (-dx, dy, 0.0))

    def frame(self) -> None:
        """Straight ahead again, at the distance it has."""
        self.remember()
        self.go(replace(self.home_pose, distance=self.goal.distance))

    def look_along(self, azimuth: float, elevation: float) -> None:
        """There is only one side to look from."""
        self.frame()

    def set_orthographic(self, orthographic: bool) -> None:
        """The warp of such packs begins at one point, so that there are no parallel rays through them. UserError."""
        if orthographic:
            raise UserError("a forward-facing scene has no orthographic view")


def orbit_camera_for(pack: Pack) -> OrbitCamera:
    return ForwardFacingCamera(pack) if pack.ndc else OrbitCamera(pack)
