"""The sparse points of a reconstruction, where the photographs of a scene see them: a first look, before anything is trained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from training.scenes.colmap import reconstruction_of
from training.scenes.files import clean_name
from training.scenes.scene import Scene

LEAST_SPREAD = 1e-9  # of cameras, in their own units


@dataclass(frozen=True)
class SparsePoints:
    """places: float64 [M, 3] in the training frame. colours: uint8 [M, 3]. tracks [M]: how many photographs show each."""

    places: np.ndarray
    colours: np.ndarray
    tracks: np.ndarray


def sparse_points(scene: Scene) -> SparsePoints | None:
    """The points behind a COLMAP scene that is not in NDC; None for others. UserError where the reconstruction is damaged."""
    if scene.kind != "colmap" or scene.ndc:
        return None
    found = reconstruction_of(scene.path)
    pose_of = {p.name: p.camera.world_T_camera for split in scene.splits.values() for p in split}
    rows = [row for row, name in enumerate(found.names) if clean_name(name) in pose_of]
    theirs = found.world_T_camera[rows]
    ours = np.stack([pose_of[clean_name(found.names[row])] for row in rows])
    # The reader turned, moved and scaled all cameras alike; so it is undone by what it did to them.
    spread, wanted = (np.linalg.norm(P[:, :3, 3] - P[:, :3, 3].mean(0), axis=-1).mean() for P in (theirs, ours))
    scale = wanted / spread if spread > LEAST_SPREAD else 1.0
    R = ours[0, :3, :3] @ theirs[0, :3, :3].T
    places = scale * (found.points - theirs[:, :3, 3].mean(0)) @ R.T + ours[:, :3, 3].mean(0)
    return SparsePoints(places, found.colours, found.tracks)
