"""Pictures of a model in training beside the photographs they should resemble."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image

from console.atomic import replacing, write_file
from training.dataset import RayDataset
from training.method import Method, Rays
from training.metrics import psnr
from training.scenes import Photograph, Scene
from training.scenes.pictures import over_background


def validation_photographs(scene: Scene, count: int = 1) -> tuple[Photograph, ...]:
    """`count` photographs (or all there are) spread evenly over val, else test, else (for want of better) train.

    The middle one of the split comes first: it is the one that is pictured.
    """
    photographs = next(scene.splits[split] for split in ("val", "test", "train") if scene.splits.get(split))
    middle = len(photographs) // 2
    spread = np.unique(np.linspace(0, len(photographs) - 1, max(count, 1)).round().astype(int))
    others = [i for i in spread if i != middle]
    if len(others) == max(count, 1):
        others.remove(min(others, key=lambda i: abs(i - middle)))
    return (photographs[middle], *(photographs[i] for i in others))


def render_photograph(
    method: Method, state: Any, dataset: RayDataset, photograph: Photograph, max_pixels: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(rendered, photographed), float32 [H, W, 3] in [0, 1] over the background.

    max_pixels: where there are more, one in so many of each row and column is compared. Both are never shrunk: a ray through the
    middle of a larger pixel does not see what a shrunk photograph shows (a lego at 800 × 800 then scored 29.5 dB, not 33.7).
    """
    camera = photograph.camera
    apart = max(1, math.ceil(math.sqrt(camera.width * camera.height / (max_pixels or math.inf))))
    some = (slice(apart // 2 % n, None, apart) for n in (camera.height, camera.width))
    places = np.arange(camera.height * camera.width).reshape(camera.height, camera.width)[tuple(some)]
    rays = Rays(*(array[places.ravel()] for array in dataset.view_rays(camera)))
    rgb = np.asarray(jax.device_get(method.render(state, rays).rgb))
    truth = over_background(photograph.load(), dataset.background)
    return np.clip(rgb.reshape(*places.shape, 3), 0.0, 1.0), truth.reshape(-1, 3)[places]


def validate(
    method: Method, state: Any, dataset: RayDataset, photographs: Sequence[Photograph], picture: Path, max_pixels: int
) -> list[float]:
    """PSNR in dB of each photograph's view; writes "photograph | rendering" of the first as a PNG at `picture`, and the
    same to latest.png beside it, where a viewer of pictures can watch it change.
    """
    scores = []
    for photograph in photographs:
        rendered, truth = render_photograph(method, state, dataset, photograph, max_pixels)
        scores.append(psnr(rendered, truth))
        if len(scores) == 1:
            picture.parent.mkdir(parents=True, exist_ok=True)
            save_side_by_side([truth, rendered], picture)
            write_file(picture.with_name("latest.png"), picture.read_bytes())
    return scores


def save_side_by_side(pictures: Sequence[np.ndarray], path: Path) -> None:
    """Writes pictures float [H, W, 3] of one height next to each other as a PNG."""
    row = np.rint(np.clip(np.concatenate(pictures, axis=1), 0, 1) * 255).astype(np.uint8)
    with replacing(path) as new:
        Image.fromarray(row).save(new, format="PNG")
