"""Review between the poses and the training: the points and cameras are looked at; box, kind of scene and up may be changed.

It goes on by itself after a while, unless something was touched.

The points and cameras are a pack that is shown like any other. Each point is a voxel of its colour, in a grid around the box
that is trained. So the camera, the frusta of the photographs and the crop box work as on a finished pack.

Notation: M points and N eyes of cameras, float64 [., 3], in one frame.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from console import collect_notices
from scenepack.blocks import fill_atlas, restore_padding
from scenepack.exports.field import Corners
from scenepack.pack import Pack
from scenepack.placement import transformed
from training.scenes import Scene, load_scene
from training.scenes.colmap import sparse_points
from training.scenes.colmap_files import Reconstruction
from training.scenes.scene import Box, Direction, cameras_of
from training.scenes.scene_options import composed
from training.scenes.space import FARTHEST, HALF_SIDE, box_of_points, looks_inwards, viewing_poses
from viewer.core.pose import Pose, Turntable, project, triple
from viewer.features.camera.orbit_camera import DEFAULT_FOV
from viewer.features.crop import crop
from viewer.features.making.make_job import RejectedPhotographs
from viewer.features.making.make_plan import Plan
from viewer.features.photographs.photographs import shots_of

if TYPE_CHECKING:
    from viewer.app.application import App

SIDE = 450  # voxels of the grid's longest side
BLOCK_SIZE = 6  # data voxels: points are far apart, and a macroblock holds few
AROUND = 1.5  # of the box that is trained: what lies around it is shown, too, to choose another box by
FEWEST = 20  # points that show something
FROM_OUTSIDE = 1.15  # of the distance at which a ball around all cameras fills the picture's height
MOST = 0.9  # of the points are seen from there
MOST_OUTSIDE = 0.5  # of the points may lie outside of the box that is trained; else the grid reaches to these, too
ASIDE, ELEVATION = 35.0, 24.0  # degrees, from behind the cameras
Kind = Literal["subject", "room", "forward"]


@dataclass(frozen=True)
class SparsePreview:
    pack: Pack  # the points and cameras
    scene: Scene  # read as seen from all around, which shows forward-facing ones best, too
    points: Reconstruction  # in its training frame
    kind: Kind  # found from the poses
    boxes: Mapping[Kind, np.ndarray]  # the [2, 3] that fits each, training frame; none for a forward-facing scene

    def places_in_grid(self) -> np.ndarray:
        """The points float64 [M, 3] in the pack's grid frame."""
        return transformed(np.linalg.inv(self.pack.worldspace_T_opengl), self.points.places)

    def eyes(self) -> np.ndarray:
        """Where the cameras stand, float64 [N, 3], training frame."""
        return np.stack([p.camera.world_T_camera[:3, 3] for split in self.scene.splits.values() for p in split])

    def overview(self) -> Pose:
        """From where points and cameras are seen from outside."""
        places = self.places_in_grid()
        eyes = np.stack([shot.view.position for shot in shots_of(self.pack)])
        middle = 0.5 * (eyes.mean(0) + np.median(places, axis=0))
        away = np.linalg.norm(places - middle, axis=-1)
        reach = max(np.linalg.norm(eyes - middle, axis=-1).max(), np.quantile(away, MOST))
        azimuth, _ = Turntable().angles(eyes.mean(0) - middle + np.array([0.0, 0.0, 1e-6]))
        distance = FROM_OUTSIDE * max(float(reach), 1e-6) / np.sin(np.radians(DEFAULT_FOV / 2))
        return Pose(triple(middle), azimuth + ASIDE, ELEVATION, distance)


def read_sparse_preview(
    folder: Path, spherify: bool = False, masks: bool = False, up: Direction | None = None
) -> SparsePreview | None:
    """The points of the scene in a folder; None if there are too few. spherify, masks, up: as training.scenes.SceneOptions."""
    try:
        with collect_notices():  # what the reader has to say is said where training reads the scene
            forward = not spherify and load_scene(folder).ndc
            scene = load_scene(folder, spherify=True, masks=masks, up=up)
        points = sparse_points(scene)
        if points is None or len(points.places) < FEWEST:
            return None
        provenance = {"scene": str(folder.resolve()), "spherify": True, "masks": masks}
        pack = points_pack(scene, points).with_metadata(provenance=provenance, cameras=cameras_of(scene))
        kind, boxes = _kinds(scene, points)
        return SparsePreview(pack, scene, points, "forward" if forward else kind, boxes)
    except Exception:  # the command that trains on the same folder says what is wrong with it
        return None


def _kinds(scene: Scene, points: Reconstruction) -> tuple[Kind, dict[Kind, np.ndarray]]:
    """What cameras that stand around look at, and the boxes that go with a subject and with a room."""
    poses = viewing_poses([photograph.camera for split in scene.splits.values() for photograph in split])
    kind: Kind = "subject" if looks_inwards(poses) else "room"
    boxes: dict[Kind, np.ndarray] = {
        "subject": box_of_points(points.places, points.tracks, HALF_SIDE, scene.aabb),
        "room": box_of_points(points.places, points.tracks, FARTHEST, scene.aabb),
        kind: scene.aabb,
    }
    return kind, {name: box for name, box in boxes.items() if _within(points.places, box).sum() >= FEWEST}


def _within(points: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Which points [M, 3] lie in a box [2, 3]: bool [M]."""
    return ((points > box[0]) & (points < box[1])).all(axis=-1)


def points_pack(scene: Scene, points: Reconstruction) -> Pack:
    """The points that lie in or around the scene's box, each a voxel; a diffuse pack. ValueError where none does."""
    grid_T_training = np.linalg.inv(scene.worldspace_T_opengl)
    box = scene.aabb
    if _within(points.places, box).mean() < MOST_OUTSIDE:
        far = box_of_points(points.places, points.tracks, FARTHEST, box)
        box = np.stack([np.minimum(box[0], far[0]), np.maximum(box[1], far[1])])
    low, high = _turned(box, grid_T_training)
    margin = 0.5 * (AROUND - 1) * (high - low)
    low, high = low - margin, high + margin
    voxel_size = float((high - low).max()) / SIDE
    blocks = np.ceil((high - low) / (voxel_size * BLOCK_SIZE)).astype(int)
    voxels = np.floor((transformed(grid_T_training, points.places) - low) / voxel_size).astype(int)
    inside = ((voxels >= 0) & (voxels < blocks * BLOCK_SIZE)).all(axis=1)
    if not inside.any():
        raise ValueError("no point lies in the box")
    voxels = voxels[inside][:, ::-1]  # z, y, x
    places, of = np.unique(voxels // BLOCK_SIZE, axis=0, return_inverse=True)  # the macroblocks with points
    content = np.zeros((len(places),) + (BLOCK_SIZE,) * 3 + (4,), np.uint8)
    z, y, x = (voxels % BLOCK_SIZE).T
    content[of.ravel(), z, y, x, :3], content[of.ravel(), z, y, x, 3] = points.colours[inside], 255
    kept = np.zeros(tuple(blocks[::-1]), bool)
    kept[tuple(places.T)] = True
    indices, rgba, _ = fill_atlas(zip(map(tuple, places.tolist()), content, strict=True), kept, BLOCK_SIZE, channels=4)
    restore_padding(rgba, indices, BLOCK_SIZE)
    width, height, depth = (blocks * BLOCK_SIZE).tolist()
    return Pack(
        voxel_size=voxel_size, min_xyz=low, grid_size=(width, height, depth), block_size=BLOCK_SIZE, atlas_indices=indices,
        atlas_rgba=rgba, atlas_features=None, view_mlp=None, worldspace_T_opengl=scene.worldspace_T_opengl,
    )  # fmt: skip


# --- The ground among the points ---

REACH = 24.0  # pixels between the mouse and a point that it means
NEIGHBOURS = 40  # points around that tell a plane; fewer than FEWEST_NEIGHBOURS tell none
FEWEST_NEIGHBOURS = 8
ROUNDS, KEPT = 4, 0.7  # fits, each to this share of the points that lie nearest to the plane before
FLATTEST = 0.35  # how thick points may be, of their lesser breadth, to be a plane


def normal_at(points: np.ndarray, index: int, eyes: np.ndarray) -> np.ndarray | None:
    """The unit normal [3], towards the cameras, of the plane about one of the points; None where there is no plane."""
    order = np.argsort(np.linalg.norm(points - points[index], axis=-1), kind="stable")
    around = points[order[:NEIGHBOURS]]
    if len(around) < FEWEST_NEIGHBOURS:
        return None
    some, spread, axes, middle = around, np.zeros(3), np.eye(3), around.mean(0)
    for _ in range(ROUNDS):  # what stands on the ground is not of it
        middle = some.mean(0)
        _, spread, axes = np.linalg.svd(some - middle, full_matrices=False)
        off = np.abs((around - middle) @ axes[2])
        some = around[np.argsort(off, kind="stable")[: max(int(KEPT * len(around)), FEWEST_NEIGHBOURS)]]
    if spread[2] > FLATTEST * max(spread[1], 1e-12):
        return None
    return axes[2] if ((eyes - middle) @ axes[2]).mean() > 0 else -axes[2]


# --- Review ---

WAIT_S = 60.0
SAME = 1e-6  # of the box's extent: a face that was not moved


@dataclass
class Review:
    plan: Plan
    sparse_preview: SparsePreview
    rejected: RejectedPhotographs | None = None  # photographs without a pose, and those that were not used
    picking: bool = False  # whether the next click picks the ground, and with it the up axis
    kind: Kind = field(init=False)  # as the user chose
    # Training begins by itself at this time (monotonic seconds); None: it waits.
    until: float | None = field(default_factory=lambda: time.monotonic() + WAIT_S)

    def __post_init__(self) -> None:
        self.kind = self.sparse_preview.kind

    @property
    def seconds_left(self) -> int | None:
        """Whole seconds until training begins, 0 once it is to begin; None if it waits."""
        return None if self.until is None else max(ceil(self.until - time.monotonic()), 0)

    def hold(self) -> None:
        """Waits for the user from now on."""
        self.until = None

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What the scene may be taken for. Only what looks forward to the reader can be forward-facing."""
        sparse = self.sparse_preview
        return tuple(kind for kind in get_args(Kind) if kind in sparse.boxes or kind == sparse.kind == "forward")

    def show_box(self, app: App, on: bool = True) -> None:
        """Cuts the points to the box that will be trained, so that its faces can be dragged; or shows them all."""
        self.hold()
        app.set(crop=self.box_in_grid() if on else None)

    def pick_ground(self, app: App, x: float, y: float) -> None:
        """Sets which way is up by the ground at a point of the viewport (window units from its corner)."""
        if not app.making.sparse_preview_shown(app):
            return
        self.hold()
        camera, points = app.camera(), self.sparse_preview.places_in_grid()
        pixels, before = project(camera, points)
        at = np.multiply(app.viewport.pixels_per_unit, (x, y))
        near = before & (np.linalg.norm(pixels - at, axis=-1) <= REACH)
        if not near.any():
            app.messages.say("There is no point. Click on points of the ground.", "warning")
            return
        away = np.linalg.norm(points - camera.position, axis=-1)
        index = int(np.argmin(np.where(near, away, np.inf)))
        normal = normal_at(self.sparse_preview.points.places, index, self.sparse_preview.eyes())
        if normal is None:
            app.messages.say("The points there do not lie in a plane. Click on points of the ground.", "warning")
        else:
            app.making.set_up(app, composed(self.plan.up, normal))

    def box_in_grid(self) -> Corners | None:
        """Crop box for the chosen kind of scene, clipped to the point grid; None if forward-facing."""
        box = self.sparse_preview.boxes.get(self.kind)
        if box is None:
            return None
        low, high = crop.whole(self.sparse_preview.pack)
        corners = np.clip(_turned(box, np.linalg.inv(self.sparse_preview.pack.worldspace_T_opengl)), low, high)
        return triple(corners[0]), triple(corners[1])

    def decided(self, cut: Corners | None) -> Plan:
        """The plan as it is trained, with what was chosen. cut: the box that the points are cut to, None for no other."""
        plan = self.plan
        spherify = plan.spherify if self.sparse_preview.kind != "forward" else self.kind != "forward"
        up = None if self.kind == "forward" else plan.up
        return replace(plan, aabb=self._box(cut), spherify=spherify, up=up, poses_only=False)

    def _box(self, cut: Corners | None) -> Box | None:
        """The box to train, training frame; None where that is the reader's own."""
        given, usual = self.sparse_preview.boxes.get(self.kind), self.box_in_grid()
        if given is None or usual is None:
            return None
        cut = cut or usual
        moved = np.abs(np.asarray(cut) - np.asarray(usual)) > SAME * (given[1] - given[0]).max()
        if not moved.any() and given is self.sparse_preview.scene.aabb:
            return None
        # A face that was not moved stays where the reader has it, be that beyond the points' grid.
        frame = self.sparse_preview.pack.worldspace_T_opengl
        whole = np.where(moved, np.asarray(cut), _turned(given, np.linalg.inv(frame)))
        x0, y0, z0, x1, y1, z1 = (float(f"{value:.4g}") for value in _turned(whole, frame).ravel())
        return x0, y0, z0, x1, y1, z1


def _turned(box: np.ndarray, to_T_from: np.ndarray) -> np.ndarray:
    """The box [2, 3] in another frame, whose axes are the same but for their order and signs."""
    corners = transformed(to_T_from, np.asarray(box))
    return np.stack([corners.min(0), corners.max(0)])
