"""Cameras of the renderer, the paths that benchmarks and turntables fly, and how far away a pack fills the picture.

Notation: the grid frame is the pack's OpenGL frame (y up), in the pack's world units; camera axes are x right, y up,
z back. A pixel (x, y) is looked through at (x + 0.5, y + 0.5), y down. In forward-facing (NDC) packs the camera stands
in the scene before the warp, and the grid frame is that scene's frame with worldspace_T_opengl undone (z mirrored).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import atan, cos, degrees, pi, radians, sin, tan

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull

from scenepack.blocks import block_data
from scenepack.cameras import Camera
from scenepack.pack import Pack, cached_per_pack
from scenepack.placement import placement_of
from training.scenes import poses
from training.scenes.lens import EQUIRECTANGULAR, MODELS, Lens, directions_at, projection_of

ORBIT_ELEVATION = 30.0  # degrees above the horizon
FORWARD_FACING_RADIUS = 0.15  # of the circle flown in the camera plane; photographs lie within about half a unit
FORWARD_FACING_FOCUS = 4.0  # distance of the point looked at; the nearest content of such scenes is at 4 / 3


@dataclass(frozen=True, eq=False)
class ViewCamera:
    """A pinhole camera, one with a lens, or an orthographic one, posed in the grid frame.

    Rays of an orthographic one are parallel to the optical axis and begin in the plane across it through the camera; fx, fy are
    pixels per unit of the grid frame then. Not for forward-facing packs, whose warp begins at one point; no distortion.
    """

    grid_T_camera: np.ndarray  # float64 [4, 4]
    fx: float  # pixels of a picture of width × height, as the next three
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    near: float = 0.0  # nothing closer than this along the optical axis is shown, units of the grid frame
    distortion: Lens = (0.0, 0.0, 0.0, 0.0)  # as in training.scenes.scene.Camera
    ray_near: float = 0.0  # rays begin so far from the camera (Pack.near)
    orthographic: bool = False
    eye_offset: float = 0.0  # of a panorama: how far to the right of the camera each ray begins, grid units
    whole_height: float = 0.0  # pixels of the picture that this view is a part of; 0: it is all of it

    @classmethod
    def look_at(
        cls,
        eye: tuple[float, float, float] | np.ndarray,
        target: tuple[float, float, float] | np.ndarray,
        up: tuple[float, float, float] | np.ndarray = (0.0, 1.0, 0.0),
        fov_degrees: float = 39.0,
        size: tuple[int, int] = (800, 800),
        *,
        mirrored: bool = False,
    ) -> ViewCamera:
        """A camera at `eye` that looks at `target`; all three vectors in the grid frame.

        fov_degrees: vertical. size: width, height in pixels. mirrored: the grid frame is left-handed towards the scene
        (see `is_mirrored`), so that the picture comes out the right way round. ValueError where eye is target.
        """
        eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
        back = eye - target
        distance = np.linalg.norm(back)
        if not distance > 0:
            raise ValueError("the camera's eye and target are the same point")
        straight_along_up = np.linalg.norm(np.cross(up, back)) < 1e-9 * max(np.linalg.norm(up), 1e-30) * distance
        any_across = np.eye(3)[np.argmin(np.abs(back))]
        grid_T_camera = poses.look_at(eye, back, any_across if straight_along_up else up)
        grid_T_camera[:3, 0] *= -1.0 if mirrored else 1.0
        return cls.posed(grid_T_camera, fov_degrees, size)

    @classmethod
    def posed(cls, grid_T_camera: np.ndarray, fov_degrees: float, size: tuple[int, int]) -> ViewCamera:
        """A camera without a lens that looks through its picture's middle. Otherwise as look_at."""
        width, height = size
        focal = 0.5 * height / tan(0.5 * radians(fov_degrees))
        return cls(grid_T_camera, focal, focal, 0.5 * width, 0.5 * height, width, height)

    @classmethod
    def from_scene_camera(cls, pack: Pack, camera: Camera) -> ViewCamera:
        """The view of a photograph's camera, distorted as its lens did; its rays begin where those of training did."""
        grid_T_camera = np.linalg.inv(pack.worldspace_T_opengl) @ np.asarray(camera.world_T_camera, np.float64)
        size = int(camera.width), int(camera.height)
        return cls(grid_T_camera, camera.fx, camera.fy, camera.cx, camera.cy, *size, 0.0, camera.distortion, pack.near)

    @classmethod
    def orbit(
        cls,
        pack: Pack,
        azimuth: float,
        elevation: float = ORBIT_ELEVATION,
        distance: float | None = None,
        fov_degrees: float = 39.0,
        size: tuple[int, int] = (800, 800),
        middle: np.ndarray | None = None,
    ) -> ViewCamera:
        """A camera that circles the pack's content about the grid's y axis; angles in degrees.

        distance: from the middle, in grid units; by default just far enough to see a ball around all content, as the
        benchmarks fly (filling_orbit fills the picture). middle: float [3], by default of the content's box.
        """
        low, high = content_box(pack)
        middle = 0.5 * (low + high) if middle is None else middle
        if distance is None:
            width, height = size
            narrower = tan(0.5 * radians(fov_degrees)) * min(1.0, width / height)
            distance = float(0.5 * np.linalg.norm(high - low) / sin(np.arctan(narrower)))
        a, e = radians(azimuth), radians(elevation)
        eye = middle + distance * np.array([cos(e) * sin(a), sin(e), cos(e) * cos(a)])
        return cls.look_at(eye, middle, fov_degrees=fov_degrees, size=size, mirrored=is_mirrored(pack))

    def as_orthographic(self, height: float) -> ViewCamera:
        """The orthographic camera at the same place whose picture shows `height` (grid units, above 0) from top to bottom."""
        scale = self.height / height
        middle = {"cx": 0.5 * self.width, "cy": 0.5 * self.height}
        return replace(self, fx=scale, fy=scale, **middle, distortion=(0.0,) * 4, orthographic=True)

    def as_panorama(
        self,
        size: tuple[int, int],
        up: tuple[float, float, float] | np.ndarray = (0.0, 1.0, 0.0),
        across: float = 360.0,
        eye_offset: float = 0.0,
    ) -> ViewCamera:
        """The equirectangular camera at the same place, level, whose middle is where this one looks.

        size: width, height in pixels. up: grid frame. across: degrees that the width spans; the height spans 180.
        """
        up = np.asarray(up, np.float64)
        back = self.grid_T_camera[:3, 2]
        level = back - (back @ up) / (up @ up) * up
        if np.linalg.norm(level) < 1e-6:  # straight up or down: the picture's upper edge tells what lies ahead
            level = -np.sign(back @ up) * self.grid_T_camera[:3, 1]
        camera = self.look_at(self.position, self.position - level, up, size=size, mirrored=self.mirrored)
        focal = {"fx": size[0] / radians(across), "fy": size[1] / pi}
        lens = MODELS["EQUIRECTANGULAR"].lens({})
        return replace(camera, **focal, near=self.near, distortion=lens, ray_near=self.ray_near, eye_offset=eye_offset)

    @property
    def fov(self) -> float:
        """Vertical field of view of a pinhole camera, degrees."""
        return degrees(2.0 * atan(0.5 * self.height / self.fy))

    @property
    def is_panorama(self) -> bool:
        return projection_of(self.distortion) == EQUIRECTANGULAR

    def resized(self, width: int, height: int) -> ViewCamera:
        """The same view as a picture of another size."""
        sx, sy = width / self.width, height / self.height
        lens = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return replace(self, width=width, height=height, whole_height=self.whole_height * sy, **lens)

    def part(self, x: int, y: int, width: int, height: int) -> ViewCamera:
        """The camera of a part of the picture, which may reach beyond it. x, y: the part's upper left corner, pixels."""
        whole = self.whole_height or self.height
        return replace(self, width=width, height=height, cx=self.cx - x, cy=self.cy - y, whole_height=whole)

    @property
    def key(self) -> tuple[object, ...]:
        """The same for cameras that show the same."""
        return self.grid_T_camera.tobytes(), *(getattr(self, field.name) for field in fields(self)[1:])

    @property
    def position(self) -> np.ndarray:
        """float64 [3] in the grid frame."""
        return self.grid_T_camera[:3, 3]

    @property
    def mirrored(self) -> bool:
        """Whether the camera's axes are left-handed, as where the grid frame mirrors the training frame."""
        return bool(np.linalg.det(self.grid_T_camera[:3, :3]) <= 0)


def is_mirrored(pack: Pack) -> bool:
    """True where the grid frame is a mirror image of the training frame, as in forward-facing packs."""
    return bool(np.linalg.det(pack.worldspace_T_opengl[:3, :3]) < 0)


def inner_box(pack: Pack) -> tuple[np.ndarray, np.ndarray]:
    """Corners (float64 [3] each, voxels) of the grid, of contracted packs of its part in the inner cube, unless there is none."""
    low, high = np.zeros(3), np.asarray(pack.grid_size, np.float64)
    if pack.contraction is None:
        return low, high
    ends = (np.array([-1.0, 1.0])[:, None] * pack.contraction - pack.min_xyz) / pack.voxel_size
    inner_low, inner_high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    return (inner_low, inner_high) if np.all(inner_low < inner_high) else (low, high)


def _inner_blocks(pack: Pack) -> np.ndarray:
    """The occupied macroblocks within inner_box, bool [z, y, x]."""
    low, high = inner_box(pack)
    first, last = np.floor(low / pack.block_size).astype(int), np.ceil(high / pack.block_size).astype(int)
    inside = np.zeros_like(pack.occupied)
    inside[tuple(slice(a, b) for a, b in zip(first[::-1], last[::-1], strict=True))] = True
    return pack.occupied & inside


def content_box(pack: Pack) -> tuple[np.ndarray, np.ndarray]:
    """float64 [3] each, grid frame: the box around the occupied macroblocks within inner_box; that box where none are."""
    low, high = inner_box(pack)
    corners = np.argwhere(_inner_blocks(pack))[:, ::-1] * float(pack.block_size)
    if len(corners):
        low, high = np.maximum(corners.min(0), low), np.minimum(corners.max(0) + pack.block_size, high)
    return pack.min_xyz + pack.voxel_size * low, pack.min_xyz + pack.voxel_size * high


def box_points(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """float64 [..., 8, 3]: corners of boxes from low to high [..., 3]; bit k of the index tells low or high along axis k."""
    ends = np.stack([low, high], axis=-2, dtype=np.float64)
    return ends[..., np.arange(8)[:, None] >> np.arange(3) & 1, np.arange(3)]


def orbit_path(
    pack: Pack, frames: int, fov_degrees: float = 39.0, size: tuple[int, int] = (800, 800)
) -> list[ViewCamera]:
    """One turn about a ball around all content; of forward-facing packs, a circle in the camera plane."""
    if pack.ndc:
        return forward_facing_path(pack, frames, fov_degrees, size)
    azimuths = [360.0 * i / frames for i in range(frames)]
    return [ViewCamera.orbit(pack, azimuth, fov_degrees=fov_degrees, size=size) for azimuth in azimuths]


def forward_facing_path(
    pack: Pack, frames: int, fov_degrees: float = 53.0, size: tuple[int, int] = (1006, 756)
) -> list[ViewCamera]:
    """A circle within the camera plane, looking at one point of the scene (SNeRG paper, appendix B)."""
    grid_R_training = np.linalg.inv(pack.worldspace_T_opengl[:3, :3])
    target = grid_R_training @ np.array([0.0, 0.0, -FORWARD_FACING_FOCUS])
    up = grid_R_training @ np.array([0.0, 1.0, 0.0])
    cameras = []
    for i in range(frames):
        turn = radians(360.0 * i / frames)
        eye = grid_R_training @ (FORWARD_FACING_RADIUS * np.array([cos(turn), sin(turn), 0.0]))
        cameras.append(ViewCamera.look_at(eye, target, up, fov_degrees, size, mirrored=is_mirrored(pack)))
    return cameras


def rays_through(camera: ViewCamera, pixels: np.ndarray) -> np.ndarray:
    """float64 [n, 3], camera axes: what pixels (float [n, 2]) look along, through the lens; one unit deep, or, of fisheyes and
    panoramas, of unit length.

    Of a camera with one eye. See ray_through for any.
    """
    x, y = pixels.T
    return directions_at((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, camera.distortion)


def ray_through(camera: ViewCamera, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the ray through a pixel begins and its unit direction, float64 [3] each, grid frame."""
    rotation = camera.grid_T_camera[:3, :3]
    if camera.orthographic:
        across = np.array([(x - camera.cx) / camera.fx, -(y - camera.cy) / camera.fy, 0.0])
        return camera.position + rotation @ across, -rotation[:, 2]
    ray = rotation @ rays_through(camera, np.array([[x, y]]))[0]
    return camera.position, ray / np.linalg.norm(ray)


# --- Filling the picture ---
#
# Measured is the convex hull around what can be seen: in the outer macroblocks, the box around voxels of some opacity. Small
# pieces apart from the rest, as training leaves in empty space, would push the camera far away; they are not counted.

MARGIN = 1.05  # of half the picture over what is seen
STRAY = 0.01  # of the macroblocks: a piece with fewer is not counted
OUTER = 1.8  # macroblocks: those closer to the hull than their diagonal may touch it
SEEN = 26  # of 255: opacity of a voxel that can be seen
TOUCHING = np.ones((3, 3, 3), bool)  # corners, too


def _counted_blocks(pack: Pack) -> np.ndarray:
    """The occupied macroblocks without stray pieces, bool [z, y, x]; of contracted packs, those in the inner cube."""
    occupied = _inner_blocks(pack)
    pieces, count = ndimage.label(occupied, TOUCHING)  # pyright: ignore[reportGeneralTypeIssues]
    if count < 2:
        return occupied
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    kept = sizes >= STRAY * sizes.sum()
    return kept[pieces] if kept.any() else occupied


@cached_per_pack
def outline(pack: Pack) -> np.ndarray:
    """Corners of the hull around what is counted, float64 [n, 3], grid frame; of the grid where a pack is empty."""
    blocks = np.argwhere(_counted_blocks(pack))  # z, y, x
    if not len(blocks):
        return box_points(*content_box(pack))
    size = pack.block_size
    corners = box_points(blocks[:, ::-1] * size, (blocks[:, ::-1] + 1) * size).reshape(-1, 3)
    hull = ConvexHull(corners)
    middles = (blocks[:, ::-1] + 0.5) * size
    inside = -(middles @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)  # to the hull's nearest face
    boxes = [box for block in blocks[inside < OUTER * size] if (box := _seen_box(pack, block)) is not None]
    if boxes:
        corners = box_points(*np.stack(boxes, axis=1)).reshape(-1, 3)
    if np.linalg.matrix_rank(corners - corners[0]) == 3:
        corners = corners[ConvexHull(corners).vertices]
    return pack.min_xyz + pack.voxel_size * np.clip(corners, *inner_box(pack))


def _seen_box(pack: Pack, block: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners (x, y, z; voxels of the grid) of the box around what is seen of a macroblock (z, y, x); None where nothing is."""
    seen = block_data(pack, pack.atlas_rgba, tuple(block))[..., 3] >= SEEN
    boxes = ndimage.find_objects(seen.astype(np.uint8))
    if not boxes:
        return None
    start = block[::-1] * float(pack.block_size)
    low, high = np.array([(side.start, side.stop) for side in boxes[0][::-1]], np.float64).T
    return start + low, start + high


def middle_of(points: np.ndarray) -> np.ndarray:
    """The middle of the box around points [n, 3]."""
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def filling_distance(local: np.ndarray, fov: float, aspect: float, *, orthographic: bool = False) -> float:
    """The least distance from which all points are in the picture; above 0.

    local: float [n, 3], about the point looked at, in camera axes (x right, y up, z back). fov: vertical, degrees. aspect:
    width over height. orthographic: the distance at which a perspective picture is as high as that of parallel rays.
    """
    half = tan(0.5 * radians(fov)) * np.array([aspect, 1.0])
    across = (MARGIN * np.abs(local[:, :2]) / half).max(axis=1)
    return max(float((across if orthographic else across + local[:, 2]).max()), 1e-6)


def filling_orbit(
    pack: Pack, frames: int, fov_degrees: float, size: tuple[int, int], first: float = 0.0
) -> list[ViewCamera]:
    """One turn about the placed frame's y axis in which no view cuts anything off (of forward-facing packs, orbit_path).

    fov_degrees: vertical. size: width, height in pixels. first: azimuth of the first view, degrees, as ViewCamera.orbit takes it.
    """
    if pack.ndc:
        return orbit_path(pack, frames, fov_degrees, size)
    azimuths = [first + 360.0 * i / frames for i in range(frames)]
    points, placed = outline(pack), np.array(placement_of(pack).rotation)
    middle, distance = middle_of(points), 0.0

    def orbit(azimuth: float, distance: float) -> ViewCamera:
        camera = ViewCamera.orbit(pack, azimuth, ORBIT_ELEVATION, distance, fov_degrees, size, np.zeros(3))
        camera.grid_T_camera[:3] = placed.T @ camera.grid_T_camera[:3]
        camera.grid_T_camera[:3, 3] += middle
        return camera

    for azimuth in azimuths:
        axes = orbit(azimuth, 1.0).grid_T_camera[:3, :3]
        distance = max(distance, filling_distance((points - middle) @ axes, fov_degrees, size[0] / size[1]))
    return [orbit(azimuth, distance) for azimuth in azimuths]
