"""Photographs that travel with the pack, small, so that they are seen where their files are not (scenepack.pictures)."""

from __future__ import annotations

import numpy as np

from scenepack.pack import Pack
from scenepack.pictures import PICTURE, picture_uri
from training.scenes.pictures import over_background
from training.scenes.scene import Scene


def with_pictures(pack: Pack, scene: Scene, side: int) -> Pack:
    """The pack with its photographs brought along, at most `side` pixels a side (scenepack.pictures); 0 for none."""
    if side <= 0:
        return pack
    photographs = [photograph for of_split in scene.splits.values() for photograph in of_split]
    cameras = []
    for entry, photograph in zip(pack.metadata["cameras"], photographs, strict=True):
        pixels = np.rint(255 * over_background(photograph.load(), scene.background)).astype(np.uint8)
        cameras.append({**entry, PICTURE: picture_uri(pixels, side)})
    return pack.with_metadata(cameras=cameras)
