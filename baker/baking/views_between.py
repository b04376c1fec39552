"""Views midway between photographs, with a wider field of view: baking keeps what only they show (baker.tuning.pruning)."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from training.dataset import MOST_RAYS, RayDataset

FOCAL_SCALE = 0.6  # of views between photographs: other cameras also show what lies just beyond their frames


def with_views_between(dataset: RayDataset, neighbours: int = 1) -> RayDataset:
    """The geometry of the photographs, and after them of a view midway between each and its nearest `neighbours`; no pixels.

    Such a view has the lens and size of one of its photographs, and FOCAL_SCALE times its focal lengths. Where there would be
    more rays than ids, there are none.
    """
    photographs, poses = _midway(np.asarray(dataset.world_T_camera, np.float64), neighbours)
    first, width = np.asarray(dataset.first, np.int64), np.asarray(dataset.width, np.int64)
    rays = np.diff(np.append(first, dataset.count))[photographs]
    count = dataset.count + int(rays.sum())
    without_pixels = replace(dataset, pixels=jnp.zeros((0, dataset.pixels.shape[1]), jnp.uint8))
    if count > MOST_RAYS:
        return without_pixels
    scale = jnp.asarray([FOCAL_SCALE, FOCAL_SCALE, 1.0, 1.0])  # of fx, fy, cx, cy
    return replace(
        without_pixels,
        world_T_camera=jnp.concatenate([dataset.world_T_camera, jnp.asarray(poses, jnp.float32)]),
        intrinsics=jnp.concatenate([dataset.intrinsics, dataset.intrinsics[photographs] * scale]),
        distortion=jnp.concatenate([dataset.distortion, dataset.distortion[photographs]]),
        first=jnp.asarray(np.append(first, dataset.count + np.cumsum(rays) - rays).astype(np.int32)),
        width=jnp.asarray(np.append(width, width[photographs]).astype(np.int32)),
        count=count,
    )


def _midway(world_T_camera: np.ndarray, neighbours: int) -> tuple[np.ndarray, np.ndarray]:
    """One of the photographs int [B] and the pose [B, 3, 4] of a view between each pair of neighbours.

    A turn by an angle counts as much as a move by that many of the cameras' median distance from their middle.
    """
    places, turns = world_T_camera[:, :, 3], world_T_camera[:, :, :3]
    spread = max(np.median(np.linalg.norm(places - places.mean(0), axis=-1)), 1e-12)
    # the chord of unit directions is about the angle
    features = np.concatenate([places / spread, turns[:, :, 2]], axis=1)
    pairs = set()
    for view, feature in enumerate(features):
        apart = np.linalg.norm(features - feature, axis=-1)
        apart[view] = np.inf
        for other in np.argsort(apart, kind="stable")[: min(neighbours, len(features) - 1)]:
            pairs.add((min(view, int(other)), max(view, int(other))))
    poses = np.empty((len(pairs), 3, 4))
    for pose, (view, other) in zip(poses, sorted(pairs), strict=True):
        both = Rotation.from_matrix(turns[[view, other]])
        pose[:, :3] = Slerp([0.0, 1.0], both)(0.5).as_matrix()
        pose[:, 3] = 0.5 * (places[view] + places[other])
    return np.array([view for view, _ in sorted(pairs)], np.int64), poses
