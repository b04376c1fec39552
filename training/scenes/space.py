"""The space of a scene: training frame, near, far and box, from cameras, points and what its files say of both.

Notation: P float64 [N, 4, 4], world_T_camera of all photographs, OpenGL axes. A box is float64 [2, 3], low and high corner.

    layout                  training frame                                      box
    Blender                 the file's, where it suits the published bounds;    cube about the origin: what cameras frame
                            else about the focus, at the published distance
    LLFF, forward-facing    mean pose; nearest depth at 4/3                     NDC: all that cameras see
    LLFF, 360 degrees       about the focus; cameras at RMS distance 1          what cameras frame, at most 1.2
    transforms, COLMAP      about the focus, z up; cameras at mean distance 1   of the points; else a cube about the origin

The focus is the point nearest to all optical axes. Opaque photographs that look inwards show all that is around, too: beyond
INNER on every side of the focus, methods that can do so contract space (scenepack.contraction), and the box does not count.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from console import UserError
from scenepack.constants import NDC_NEAR
from training.scenes.lens import NO_DISTORTION, PERSPECTIVE, directions_at, projection_of
from training.scenes.poses import axes_along, focus_point
from training.scenes.scene import Camera, Photograph, Space, camera_rays, ndc_rays, pixel_grid, pixels_of

# docs/format.md, "Coordinate frames": the pack's grid frame (y up) to a training frame whose z is up, and to NDC.
WORLDSPACE_T_OPENGL = np.array([[-1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=np.float64)
NDC_WORLDSPACE_T_OPENGL = np.diag([1.0, 1.0, -1.0, 1.0])

# NeRF-synthetic's bounds: cameras at 4.03 frame 1.45 to either side of the origin.
SYNTHETIC_DISTANCE, SYNTHETIC_NEAR, SYNTHETIC_FAR, SYNTHETIC_HALF_SIDE = 4.03, 2.0, 6.0, 1.5
SYNTHETIC_SUITS = 0.25  # how far, as a share, cameras may differ from that and still keep its bounds
FRAMED_MARGIN = 1.03  # of a box around what cameras frame

BOUNDS_FACTOR = 0.75  # LLFF's: the nearest depth becomes 1 / 0.75
NEAR_360, FAR_360, HALF_SIDE_360 = 0.45, 100.0, 1.2  # LLFF: near at most, far at least, box at most

# Of captures, in units of the cameras' mean distance from the focus:
NEAR, FAR = 0.1, 100.0  # where no points tell
HALF_SIDE = 1.5  # of the box of a capture that looks inwards
INNER = 0.75  # half side of the cube that is not contracted: it holds what most cameras look at
OUTWARD_HALF_SIDE = 3.0  # of one that looks outwards, where no points tell
FARTHEST = 30.0  # reach of the points' box of a capture that looks outwards
NEAREST, NEAREST_FAR = 0.02, 10.0  # near is at least, far at least
FEWEST_POINTS = 50  # fewer say little of where the content is
WIDEST = 1.0  # radians from the axis that a fisheye frames, at most: its picture may go on behind the camera
INLIERS = 0.01, 0.99  # shares of all observations, between which lie the box and the distances
MARGIN, LEAST_MARGIN = 0.1, 0.05  # around the points, as a share of their extent, and at least
FRAMED, FEW_FRAMES = 0.95, 0.02  # how much of its points a picture's frame is put behind; share of the frames left out


class Frame(NamedTuple):
    """The training frame in the file's: p_training = scale · (p_file − centre) @ axes. axes [3, 3] by columns."""

    axes: np.ndarray
    centre: np.ndarray
    scale: float

    def poses(self, P: np.ndarray) -> np.ndarray:
        """Poses [N, 4, 4] in the training frame."""
        moved = P.copy()
        moved[:, :3, :3] = self.axes.T @ P[:, :3, :3]
        moved[:, :3, 3] = self.points(P[:, :3, 3])
        return moved

    def points(self, places: np.ndarray) -> np.ndarray:
        """Points [M, 3] in the training frame."""
        return self.scale * (places - self.centre) @ self.axes


@dataclass(frozen=True)
class PointCloud:
    places: np.ndarray  # [M, 3]
    weights: np.ndarray  # [M]: in how many photographs each was found
    seen: Sequence[np.ndarray]  # of each photograph, the rows of the points it shows

    @property
    def suffices(self) -> bool:
        """Whether there are enough to tell where things are."""
        return len(self.places) >= FEWEST_POINTS and sum(map(len, self.seen)) >= FEWEST_POINTS


# --- training frames --------------------------------------------------------------------------------------------------


def _centre(P: np.ndarray) -> tuple[np.ndarray, float]:
    """The focus, or the middle of cameras that look the same way or away from one another; their mean distance from it."""
    centre, eyes = focus_point(P), P[:, :3, 3]
    if centre is None or (((centre - eyes) * -P[:, :3, 2]).sum(-1) > 0).mean() < 0.5:
        centre = eyes.mean(0)
    return centre, float(np.linalg.norm(eyes - centre, axis=-1).mean())


def frame_about_focus(P: np.ndarray) -> Frame:
    """About the focus (else the middle of the cameras), z their mean up direction, their mean distance 1."""
    centre, distance = _centre(P)
    up = P[:, :3, 1].mean(0)
    axes = axes_along(up, np.eye(3)[np.argmin(np.abs(up))]) if np.linalg.norm(up) > 1e-3 else np.eye(3)
    return Frame(axes, centre, 1.0 / distance if distance > 1e-9 else 1.0)


def frame_of_object(cameras: Sequence[Camera]) -> Frame:
    """The file's own frame, where the published bounds suit it; else about the focus at the published distance."""
    centre, distance = _centre(viewing_poses(cameras))
    stays = np.linalg.norm(centre) <= SYNTHETIC_SUITS * distance and _published_bounds_suit(cameras, centre)
    if stays or distance < 1e-9:
        return Frame(np.eye(3), np.zeros(3), 1.0)
    return Frame(np.eye(3), centre, SYNTHETIC_DISTANCE / distance)


def frame_of_sphere(P: np.ndarray) -> Frame:
    """LLFF's: about the focus, z the mean direction to the cameras, these at root mean square distance 1."""
    centre = focus_point(P)
    if centre is None:
        raise UserError("all cameras look the same way, so they have no common centre", where="poses_bounds.npy",
                        remedy="leave out --spherify")  # fmt: skip
    aside = P[:, :3, 3] - centre
    distance = np.sqrt(np.square(aside).sum(-1).mean())
    return Frame(axes_along(aside.mean(0), np.array([0.1, 0.2, 0.3])), centre, 1.0 / distance)  # across: NeRF's choice


def frame_forward(P: np.ndarray, nearest: float) -> Frame:
    """Of a forward-facing capture, before the NDC warp: the mean pose, and the nearest depth behind the NDC near plane."""
    if np.linalg.norm(P[:, :3, 2].mean(0)) < 1e-3:
        raise _not_forward("the cameras look into opposite directions")
    axes = axes_along(P[:, :3, 2].sum(0), P[:, :3, 1].sum(0))
    return Frame(axes, P[:, :3, 3].mean(0), 1.0 / (BOUNDS_FACTOR * nearest))


# --- near, far and box ------------------------------------------------------------------------------------------------


def space_of_object(cameras: Sequence[Camera], *, opaque: bool) -> Space:
    """Of an object in its frame_of_object: the published bounds, or what training cameras frame about the origin. Cameras that
    look outwards may stand indoors, unless the object was cut out: then they are wrong, and see nothing of the box."""
    origin, P = np.zeros(3), viewing_poses(cameras)
    inwards = looks_inwards(P)
    if _published_bounds_suit(cameras, origin) or not (inwards or opaque):
        return Space(SYNTHETIC_NEAR, SYNTHETIC_FAR, cube(SYNTHETIC_HALF_SIDE), WORLDSPACE_T_OPENGL)
    distances = np.linalg.norm(P[:, :3, 3], axis=-1)
    half = FRAMED_MARGIN * framed_half_side(cameras, origin)
    if not inwards:
        half = OUTWARD_HALF_SIDE * (float(distances.mean()) or 1.0)
    reach = float(np.sqrt(3.0) * half)
    near = max(float(distances.min()) - reach, NEAREST * SYNTHETIC_DISTANCE)
    return Space(near, float(distances.max()) + reach, cube(half), WORLDSPACE_T_OPENGL)


def space_of_bounds(photographs: Sequence[Photograph], bounds: np.ndarray, *, opaque: bool) -> Space:
    """Of a 360° capture in its frame_of_sphere, by nearest and farthest depths [N, 2]. opaque: see space_of_capture."""
    cameras = [photograph.camera for photograph in photographs]
    corners = [np.hypot(c.width / c.fx, c.height / c.fy) / 2 for c in cameras]
    framed = (np.linalg.norm(poses_of(cameras)[:, :3, 3], axis=-1) * corners).max()
    near = float(np.clip(0.9 * bounds.min(), 0.05, NEAR_360))
    far, inner = max(FAR_360, float(bounds.max())), INNER if opaque else None
    box = cube(min(HALF_SIDE_360, float(framed)))
    return Space(near, far, box, WORLDSPACE_T_OPENGL, contraction=inner, disparity=True)


def space_of_capture(
    cameras: Sequence[Camera], points: PointCloud | None, *, opaque: bool, file_box: np.ndarray | None = None
) -> Space:
    """Of a capture in its frame_about_focus. points: in that frame; None where there are too few to tell. opaque: photographs are
    trained up to their corners. file_box: what the file names, in that frame; it counts where no points tell, if it holds the
    focus, and as far as HALF_SIDE where cameras look inwards."""
    P = viewing_poses(cameras)
    inwards = looks_inwards(P)
    reach, near, far = HALF_SIDE if inwards else FARTHEST, NEAR, FAR
    if points is not None:
        near, far = _near_far(P, points)
        box = box_of_points(points.places, points.weights, reach, otherwise=cube(HALF_SIDE))
        box = _with_frames(box, cameras, points) if opaque else box
    elif file_box is not None and (file_box[0] < 0).all() and (file_box[1] > 0).all():
        box = np.clip(file_box, -reach, reach)
    elif not inwards:
        box = cube(OUTWARD_HALF_SIDE)
    else:
        box = cube(HALF_SIDE if opaque else min(HALF_SIDE, FRAMED_MARGIN * framed_half_side(cameras, np.zeros(3))))
    inner, guessed = INNER if opaque and inwards else None, opaque and points is None
    return Space(near, far, box, WORLDSPACE_T_OPENGL, contraction=inner, disparity=True, guessed=guessed)


def space_forward(photographs: Sequence[Photograph]) -> Space:
    """Of a forward-facing capture, in NDC. UserError where a photograph sees what the warp cannot show."""
    camera = photographs[0].camera
    ndc_camera = (camera.width, camera.height, camera.fx)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for name, camera in ((one.name, one.camera) for one in photographs):  # the corners bound what any view sees
        origins, directions = camera_rays(camera, *pixel_grid(camera, 2))
        if (directions[..., 2] > -1e-3).any() or (origins[..., 2] < -NDC_NEAR).any():
            raise _not_forward(name)
        origins, directions = ndc_rays(origins, directions, *ndc_camera)
        ends = np.concatenate([origins, origins + directions])
        low, high = np.minimum(low, ends.min((0, 1))), np.maximum(high, ends.max((0, 1)))
    aabb = np.stack([low, high])
    return Space(0.0, 1.0, aabb, NDC_WORLDSPACE_T_OPENGL, ndc=True, ndc_camera=ndc_camera)


def nearest_depth(P: np.ndarray, points: PointCloud) -> float:
    """The nearest depth of what any photograph shows, outliers left out: by all that is shown where one shows too little."""
    weights = [points.weights[rows] for rows in points.seen]
    shown = zip(P, points.seen, strict=True)
    depths = [np.maximum(-(points.places[rows] - pose[:3, 3]) @ pose[:3, 2], 1e-6) for pose, rows in shown]
    whole = _quantiles(np.concatenate(depths), np.concatenate(weights))[0]
    pairs = zip(depths, weights, strict=True)
    return min(_quantiles(d, w)[0] if len(d) >= FEWEST_POINTS else whole for d, w in pairs)


def _published_bounds_suit(cameras: Sequence[Camera], centre: np.ndarray) -> bool:
    """Whether cameras look at `centre` [3] from about as far, and frame about as much there, as NeRF-synthetic's do."""
    P = viewing_poses(cameras)
    P[:, :3, 3] -= centre
    distance = np.linalg.norm(P[:, :3, 3], axis=-1).mean() / SYNTHETIC_DISTANCE
    framed = framed_half_side(cameras, centre) / SYNTHETIC_HALF_SIDE
    return looks_inwards(P) and abs(distance - 1) <= SYNTHETIC_SUITS and abs(framed - 1) <= SYNTHETIC_SUITS


def rows_in_picture(camera: Camera, places: np.ndarray) -> np.ndarray:
    """Rows of the places [M, 3] that lie within the picture."""
    pixels, shown = pixels_of(camera, places)
    return np.flatnonzero(shown & ((pixels >= 0) & (pixels <= (camera.width, camera.height))).all(-1))


def cube(half_side: float) -> np.ndarray:
    """The box [2, 3] of a cube about the origin."""
    return np.array([[-half_side] * 3, [half_side] * 3])


def poses_of(cameras: Sequence[Camera]) -> np.ndarray:
    """Poses [N, 4, 4]."""
    return np.stack([camera.world_T_camera for camera in cameras])


def viewing_poses(cameras: Sequence[Camera]) -> np.ndarray:
    """Poses [N, 4, 4] whose z axes say which way cameras look. Panoramas look every way: theirs are turned, level, towards the
    middle of all cameras."""
    P = poses_of(cameras)
    aside = P[:, :3, 3] - P[:, :3, 3].mean(0)
    for pose, camera, back in zip(P, cameras, aside, strict=True):
        level = back - (back @ pose[:3, 1]) * pose[:3, 1]
        if camera.is_panorama and np.linalg.norm(level) > 1e-9:
            pose[:3, :3] = axes_along(level, pose[:3, 1])
    return P


def framed_half_side(cameras: Sequence[Camera], centre: np.ndarray) -> float:
    """How far aside, at most, a camera frames at its distance from `centre` [3]."""
    distances = np.linalg.norm(poses_of(cameras)[:, :3, 3] - centre, axis=-1)
    aside = [max(max(c.cx, c.width - c.cx) / c.fx, max(c.cy, c.height - c.cy) / c.fy) for c in cameras]
    angles = [projection_of(c.distortion) != PERSPECTIVE for c in cameras]
    aside = np.where(angles, np.tan(np.minimum(aside, WIDEST)), aside)
    return float((distances * aside).max())


def looks_inwards(P: np.ndarray) -> bool:
    """Whether most cameras [N, 4, 4], about the origin, look at something between them, and not at walls around them."""
    return bool(((P[:, :3, 2] * P[:, :3, 3]).sum(-1) > 0).mean() > 0.5)


def box_of_points(places: np.ndarray, weights: np.ndarray, reach: float, otherwise: np.ndarray) -> np.ndarray:
    """The box [2, 3] of nearly all points, `reach` to either side at most; `otherwise` where there are too few."""
    counted = np.abs(places).max(-1) < FARTHEST
    if counted.sum() < FEWEST_POINTS:
        return otherwise
    low, high = np.stack([_quantiles(values, weights[counted]) for values in places[counted].T], axis=1)
    margin = np.maximum(MARGIN * (high - low), LEAST_MARGIN)
    box = np.clip(np.stack([low - margin, high + margin]), -reach, reach)
    return box if (box[1] > box[0]).all() else otherwise


def _near_far(P: np.ndarray, points: PointCloud) -> tuple[float, float]:
    """Where rays begin and end: what photographs show lies between, with a margin."""
    shown = zip(P, points.seen, strict=True)
    apart = [np.linalg.norm(points.places[rows] - pose[:3, 3], axis=-1) for pose, rows in shown]
    weights = [points.weights[rows] for rows in points.seen]
    low, high = _quantiles(np.concatenate(apart), np.concatenate(weights))
    # the camera that comes closest counts: cells this near to any camera are empty
    seen = zip(apart, weights, strict=True)
    low = min([_quantiles(d, w)[0] for d, w in seen if len(d) >= FEWEST_POINTS], default=low)
    return float(np.clip(0.7 * low, NEAREST, NEAR_360)), float(max(2.0 * high, NEAREST_FAR))


def _with_frames(box: np.ndarray, cameras: Sequence[Camera], points: PointCloud) -> np.ndarray:
    """The box [2, 3] grown to nearly all that opaque photographs show, up to their corners: points thin out towards these, and
    what is cut off is trained as specks before the lens."""
    frames = []
    for camera, rows in zip(cameras, points.seen, strict=True):
        if len(rows) < FEWEST_POINTS:
            continue
        pose = camera.world_T_camera
        depths = -(points.places[rows] - pose[:3, 3]) @ pose[:3, 2]
        _, depth = _quantiles(depths, points.weights[rows], (0.0, FRAMED))
        x, y = pixel_grid(camera, 2)
        lens = NO_DISTORTION if projection_of(camera.distortion) == PERSPECTIVE else camera.distortion
        corners = directions_at((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, lens)
        frames.append(pose[:3, 3] + depth * corners.reshape(4, 3) @ pose[:3, :3].T)
    if not frames:
        return box
    low, high = np.quantile(np.min(frames, 1), FEW_FRAMES, 0), np.quantile(np.max(frames, 1), 1 - FEW_FRAMES, 0)
    reach = max(HALF_SIDE, np.abs(box).max())  # as far as the points' box may reach, where cameras look inwards
    return np.stack([np.minimum(box[0], np.maximum(low, -reach)), np.maximum(box[1], np.minimum(high, reach))])


def _quantiles(values: np.ndarray, weights: np.ndarray, shares: Sequence[float] = INLIERS) -> np.ndarray:
    """Quantiles [2] of weighted values [K]; by default their ends without outliers."""
    return np.quantile(values, shares, weights=weights, method="inverted_cdf")


def _not_forward(found: str) -> UserError:
    return UserError("not a forward-facing capture", where="poses_bounds.npy", found=found, remedy="use --spherify")
