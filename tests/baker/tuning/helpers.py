"""Packs to tune."""

from dataclasses import replace
from typing import Any

import numpy as np

from scenepack import Pack
from tests.scenepack.random_packs import random_pack, random_view_mlp


def pack_of(seed: int = 7, **options: Any) -> Pack:
    """A random pack where the photographs look. No voxel is quite opaque: that has no gradient of its density."""
    pack = random_pack(np.random.default_rng(seed), block_size=14, grid_blocks=(2, 2, 2), style="blob", **options)
    size = np.array(pack.grid_size) * 0.06
    if not options.get("diffuse"):
        pack = replace(pack, view_mlp=random_view_mlp(np.random.default_rng(8), 0.5))
    features = None if pack.atlas_features is None else np.minimum(pack.atlas_features, 250)
    rgba = np.minimum(pack.atlas_rgba, 250)
    return replace(pack, voxel_size=0.06, min_xyz=-0.5 * size, atlas_rgba=rgba, atlas_features=features)


def copied(pack: Pack) -> Pack:
    """A pack that may be changed."""
    features = None if pack.atlas_features is None else pack.atlas_features.copy()
    return replace(pack, atlas_rgba=pack.atlas_rgba.copy(), atlas_features=features)
