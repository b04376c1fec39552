"""Between the poses and the training: the points and cameras are looked at, and the box or the kind of scene may be changed.

Who is away does not hold it up: after a while it goes on by itself, unless something was touched.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from scenepack.pack import Pack
from training.scenes.scene import Box, Direction
from training.scenes.scene_options import composed
from viewer.core.pose import triple
from viewer.features.crop import crop
from viewer.features.making.make_job import RejectedPhotographs
from viewer.features.making.make_plan import Plan
from viewer.features.making.sparse_preview import Kind, SparsePreview, normal_at, point_under
from viewer.rendering.camera import ViewCamera

if TYPE_CHECKING:
    from viewer.app.application import App

WAIT_S = 60.0
SAME = 1e-6  # of the box's extent: a face that was not moved


@dataclass
class Review:
    """Review of the poses that were found, before training begins."""

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
        """Whole seconds until training begins; None if it waits."""
        return None if self.until is None else max(round(self.until - time.monotonic()), 0)

    @property
    def due(self) -> bool:
        """Whether training begins now."""
        return self.until is not None and time.monotonic() >= self.until

    def hold(self) -> None:
        """Waits for the user from now on."""
        self.until = None

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What the scene may be taken for. Only what looks forward to the reader can be forward-facing."""
        around: tuple[Kind, ...] = ("subject", "room")
        around = tuple(kind for kind in around if kind in self.sparse_preview.boxes)
        return (*around, "forward") if self.sparse_preview.kind == "forward" else around

    def show_box(self, app: App, on: bool = True) -> None:
        """Cuts the points to the box that will be trained, so that its faces can be dragged; or shows them all."""
        self.hold()
        app.set(crop=self.box_in_grid() if on else None)

    def choose(self, kind: Kind) -> None:
        """Takes the scene for a subject or a room, with the box that fits, or for forward-facing, which has none."""
        self.hold()
        self.kind = kind

    def up_at(self, camera: ViewCamera, x: float, y: float) -> Direction | str:
        """What is up (for the plan), where the ground is clicked on at a pixel; or in words, why that is impossible."""
        index = point_under(camera, self.sparse_preview.places_in_grid(), x, y)
        if index is None:
            return "There is no point. Click on points of the ground."
        normal = normal_at(self.sparse_preview.points.places, index, self.sparse_preview.eyes())
        if normal is None:
            return "The points there do not lie in a plane. Click on points of the ground."
        return composed(self.plan.up, normal)

    def box_in_grid(self) -> crop.Box | None:
        """Crop box for the chosen kind of scene, clipped to the point grid; None if forward-facing."""
        box = self.sparse_preview.boxes.get(self.kind)
        return None if box is None else in_grid(self.sparse_preview.pack, box)

    def decided(self, cut: crop.Box | None) -> Plan:
        """The plan as it is trained, with what was chosen. cut: the box that the points are cut to, None for no other."""
        plan = self.plan
        spherify = plan.spherify if self.sparse_preview.kind != "forward" else self.kind != "forward"
        up = None if self.kind == "forward" else plan.up
        return replace(plan, aabb=self._box(cut), spherify=spherify, up=up, poses_only=False)

    def _box(self, cut: crop.Box | None) -> Box | None:
        """The box to train, training frame; None where that is the reader's own."""
        given, usual = self.sparse_preview.boxes.get(self.kind), self.box_in_grid()
        if given is None or usual is None:
            return None
        cut = cut or usual
        moved = np.abs(np.asarray(cut) - np.asarray(usual)) > SAME * (given[1] - given[0]).max()
        if not moved.any() and given is self.sparse_preview.scene.aabb:
            return None
        # A face that was not moved stays where the reader has it, be that beyond the points' grid.
        whole = np.where(moved, np.asarray(cut), _turned(given, np.linalg.inv(_frame(self.sparse_preview.pack))))
        x0, y0, z0, x1, y1, z1 = (
            float(f"{value:.4g}") for value in _turned(whole, _frame(self.sparse_preview.pack)).ravel()
        )
        return x0, y0, z0, x1, y1, z1


def in_grid(pack: Pack, box: np.ndarray) -> crop.Box:
    """A box [2, 3] of the training frame as the crop box of a pack, within its content."""
    low, high = crop.whole(pack)
    corners = np.clip(_turned(box, np.linalg.inv(_frame(pack))), low, high)
    return triple(corners[0]), triple(corners[1])


def _frame(pack: Pack) -> np.ndarray:
    return np.asarray(pack.worldspace_T_opengl, np.float64)


def _turned(box: np.ndarray, to_T_from: np.ndarray) -> np.ndarray:
    """The box [2, 3] in another frame, whose axes are the same but for their order and signs."""
    corners = np.asarray(box) @ to_T_from[:3, :3].T + to_T_from[:3, 3]
    return np.stack([corners.min(0), corners.max(0)])
