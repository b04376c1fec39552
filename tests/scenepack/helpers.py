"""Packs on disk for tests: small, and easy to spoil."""

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np

from scenepack import Pack, ViewMlp, save_pack
from tests.scenepack.random_packs import random_pack, random_view_mlp
from tests.scenepack.volumes import cube_pack


def small_pack(seed: int = 0, **options: Any) -> Pack:
    """A pack of a few macroblocks of 6 voxels: about 100 KB decoded."""
    settings: dict[str, Any] = {"block_size": 6, "grid_blocks": (3, 2, 2), "style": "noise", "occupancy": 0.1}
    return random_pack(np.random.default_rng(seed), **{**settings, **options})


def smooth_pack() -> Pack:
    """A thick shell of smooth colours and features across eight macroblocks, like a bake."""
    z, y, x = np.mgrid[:25, :25, :25]
    radius = np.sqrt((z - 12.5) ** 2 + (y - 12.5) ** 2 + (x - 8) ** 2)
    alpha = np.clip(255 - 30 * np.abs(radius - 9), 0, 255).astype(np.uint8)
    waves = [0.5 + 0.4 * np.sin(x / (3 + i) + y / 5 + i * z / 9) for i in range(7)]
    values = np.stack([np.rint(wave * alpha) for wave in waves], axis=-1).astype(np.uint8)
    rgba = np.concatenate([values[..., :3], alpha[..., None]], axis=-1)
    return cube_pack(rgba, 14, features=values[..., 3:], view_mlp=random_view_mlp(np.random.default_rng(5)))


def written(folder: Path, pack: Pack | None = None) -> Path:
    save_pack(small_pack() if pack is None else pack, folder)
    return folder


def images(folder: Path) -> list[Path]:
    """The files of a pack that hold its atlas."""
    return sorted(f for f in folder.iterdir() if f.name not in ("scene_params.json", "atlas_indices.png"))


def edit_json(file: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Changes the object in a file; of a pack, given its folder, in its JSON."""
    file = file / "scene_params.json" if file.is_dir() else file
    values = json.loads(file.read_text())
    change(values)
    file.write_text(json.dumps(values))


def read_json(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "scene_params.json").read_text())


def read_image(file: Path) -> np.ndarray:
    return imagecodecs.png_decode(file.read_bytes())


def write_image(file: Path, pixels: np.ndarray) -> None:
    file.write_bytes(imagecodecs.png_encode(np.ascontiguousarray(pixels), 1))


def same_pack(a: Pack, b: Pack) -> bool:
    """Whether every field but params is equal."""

    def same(x: Any, y: Any) -> bool:
        if isinstance(x, ViewMlp):
            return isinstance(y, ViewMlp) and all(map(same, x.weights + x.biases, y.weights + y.biases))
        return np.array_equal(x, y) and getattr(x, "dtype", None) == getattr(y, "dtype", None)

    return all(same(getattr(a, field.name), getattr(b, field.name)) for field in fields(a) if field.name != "params")
