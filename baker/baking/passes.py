"""Passes over a bake's voxels, from what the field gave to the pack; see passes_of for their order.

padding         the borders of macroblocks repeat their neighbours                       SNeRG section 5.1
sharpening      voxels of contracted space make up for what interpolation blurs          not in the paper
pruning         voxels that hardly show in any photograph are emptied                    not in the paper
feature scale   features at a quarter, the view MLP's weights for them at four times     not in the paper
tuning          voxels and view MLP together, on what the viewer shows                   not in the paper
view MLP        the view MLP alone, on what the viewer shows                             section 5.5
hidden voxels   occluded voxels copy their neighbours, which takes fewer bytes           not in the paper

Pruning and hidden voxels also look from midway between photographs, with a wider field of view: what only such views show stays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from baker.baking.config import BakeConfig
from baker.tuning.fine_tune import fine_tune
from baker.tuning.joint_tuning import JointConfig, joint_tune, shown_psnr
from baker.tuning.pruning import Pruned, arriving_transmittance, prune, smooth_hidden
from console.progress import Progress
from scenepack.blocks import block_copy, restore_pack_padding
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import Pack
from training.dataset import MOST_RAYS, RayDataset
from training.multires.fused.compiled import Workers

FOCAL_SCALE = 0.6  # of views between photographs: other cameras also show what lies just beyond their frames


def with_views_between(dataset: RayDataset) -> RayDataset:
    """The geometry of the photographs, and after them of a view midway between each and its nearest neighbour; no pixels.

    Such a view has the lens and size of one of its photographs, and FOCAL_SCALE times its focal lengths. Where there would be
    more rays than ids, there are none.
    """
    photographs, poses = _midway(np.asarray(dataset.world_T_camera, np.float64))
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


def _midway(world_T_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
        if len(features) > 1:
            pairs.add(tuple(sorted((view, int(apart.argmin())))))
    poses = np.empty((len(pairs), 3, 4))
    for pose, (view, other) in zip(poses, sorted(pairs), strict=True):
        pose[:, :3] = Slerp([0.0, 1.0], Rotation.from_matrix(turns[[view, other]]))(0.5).as_matrix()
        pose[:, 3] = 0.5 * (places[view] + places[other])
    return np.array([view for view, _ in sorted(pairs)], np.int64), poses


FEATURE_SCALE = 0.25  # what a tuned pack stores of features: a fifth fewer bytes, and as good once it is tuned
COMPACT = Steps(2, 2, 4)  # of what a compact pack stores; costs lego 0.06 to 0.12, fern 0.14 dB of test views
MOST_LOST_PRUNED = 0.1  # dB of training rays; tuning regains it, quality draft does not
MOST_LOST_HIDDEN = 0.03  # dB of training rays, which nothing regains


@dataclass(frozen=True)
class Voxels:
    """State of a bake between passes."""

    pack: Pack
    photographs: RayDataset  # with the exposure that the field has
    config: BakeConfig
    pruned: Pruned | None = None
    steps: Steps = EXACT  # of what is stored
    notes: Mapping[str, Any] = field(default_factory=dict)  # for the pack's provenance

    @property
    def by_opacity(self) -> bool:
        """Whether photographs also show what lies outside of the pack's box; see baker.tuning.shading.ErrorTerms."""
        return self.config.aabb is not None

    def score(self, pack: Pack) -> float:
        """How well a pack shows training rays, dB."""
        return shown_psnr(pack, self.photographs, self.config.seed, by_opacity=self.by_opacity)

    def transmittance(self, bar: Progress) -> np.ndarray | None:
        """As arriving_transmittance, in the photographs and in views between them; half of the work of its pass."""
        views, seed = with_views_between(self.photographs), self.config.seed
        return arriving_transmittance(self.pack, views, seed, lambda share: bar.update(0.5 * share, "transmittance"))

    def noted(self, **notes: Any) -> Voxels:
        return replace(self, notes={**self.notes, **notes})


Pass = Callable[[Voxels, Progress], Voxels]


def passes_of(config: BakeConfig) -> list[tuple[str, Pass]]:
    """The passes of a bake by name, in order."""
    if config.preset == "paper":
        first, tuning = [("padding", padded)], [("view MLP", with_tuned_view_mlp)]
    else:
        first = [("padding", padded), ("sharpening", sharpened), ("pruning", pruned)]
        tuning = [("feature scale", with_scaled_features), ("tuning", tuned), ("hidden voxels", smoothed)]
    return first if config.quality == "draft" else [*first, *tuning]


def padded(voxels: Voxels, bar: Progress) -> Voxels:
    restore_pack_padding(voxels.pack)
    return voxels


def sharpened(voxels: Voxels, bar: Progress) -> Voxels:
    """Makes voxels of contracted space what interpolates best, in place; empty ones stay empty. Other packs stay as they are.

    Between samples of a function f, linear interpolation is f'' / 12 too high in the mean. So each value loses a twelfth of its
    second difference along each axis (quasi-interpolation; Condat, Blu and Unser 2005).
    """
    pack = voxels.pack
    if pack.contraction is None:
        return voxels
    blocks = np.argwhere(pack.occupied)

    def sharpen(_: int, number: int) -> None:
        copies = [block_copy(pack, atlas, tuple(blocks[number])) for atlas in pack.atlases]
        values = np.concatenate(copies, axis=-1).astype(np.float32)
        for axis in range(3):
            along = np.moveaxis(values, axis, 0)
            along = along[1:-1] - np.diff(along, 2, axis=0) / np.float32(12)
            values = np.moveaxis(along, 0, axis)
        data = [copy[1:-1, 1:-1, 1:-1] for copy in copies]
        alpha = np.rint(values[..., 3:4].clip(0, 255)) * (data[0][..., 3:4] > 0)
        values = np.rint(values).clip(0, alpha)
        values[..., 3:4] = alpha
        for old, new in zip(data, np.split(values, [4], axis=-1), strict=False):
            old[...] = new
        bar.update((number + 1) / len(blocks))

    Workers().share(len(blocks), sharpen)
    restore_pack_padding(pack)
    return voxels


def pruned(voxels: Voxels, bar: Progress) -> Voxels:
    """Empties faint voxels, as far as PSNR on the photographs allows it."""
    if (arriving := voxels.transmittance(bar)) is None:
        return voxels
    pack, done = prune(voxels.pack, arriving, voxels.score, MOST_LOST_PRUNED)
    counts = {"before": done.voxels_before, "after": done.voxels_after, "tau_weight": done.tau_weight}
    return replace(voxels, pack=pack, pruned=done).noted(voxels=counts)


def with_scaled_features(voxels: Voxels, bar: Progress) -> Voxels:
    """Stores FEATURE_SCALE times the features, in place; the view MLP's weights for them grow by as much. Eight bits say more of
    features than a picture shows."""
    features, head = voxels.pack.atlas_features, voxels.pack.view_mlp
    if features is None or head is None:
        return voxels
    scaled = np.rint(FEATURE_SCALE * np.arange(256)).astype(np.uint8)
    for plane in features:
        plane[...] = scaled[plane]
    first = head.weights[0].copy()
    first[-features.shape[-1] :] /= FEATURE_SCALE
    return replace(voxels, pack=replace(voxels.pack, view_mlp=replace(head, weights=(first, *head.weights[1:]))))


def tuned(voxels: Voxels, bar: Progress) -> Voxels:
    """Tunes voxels, in place, and the view MLP."""
    quality = voxels.config.quality
    config = JointConfig(seed=voxels.config.seed, steps=COMPACT if quality == "compact" else EXACT)
    pack, figures = joint_tune(voxels.pack, voxels.photographs, config, bar.update, voxels.by_opacity)
    if not figures:
        return voxels
    return replace(voxels, pack=pack, steps=config.steps).noted(fine_tuning={"quality": quality, **figures})


def with_tuned_view_mlp(voxels: Voxels, bar: Progress) -> Voxels:
    pack, figures = fine_tune(
        voxels.pack, voxels.photographs, seed=voxels.config.seed, by_opacity=voxels.by_opacity, on_share=bar.update
    )
    return replace(voxels, pack=pack).noted(fine_tuning=figures) if figures else voxels


def smoothed(voxels: Voxels, bar: Progress) -> Voxels:
    """Copies neighbours into hidden voxels of a compact pack; other packs stay as they are."""
    arriving = None if voxels.steps == EXACT else voxels.transmittance(bar)
    if arriving is None:
        return voxels
    pack, below = smooth_hidden(voxels.pack, arriving, voxels.steps, voxels.score, MOST_LOST_HIDDEN)
    return replace(voxels, pack=pack).noted(hidden_below=below)
