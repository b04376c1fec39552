"""Pictures of a model in training beside the photographs they should resemble."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from PIL import Image

from console.atomic import replacing, write_file
from training.dataset import RayDataset
from training.method import Method
from training.metrics import psnr
from training.scenes import Photograph, Scene
from training.scenes.pictures import over_background, shrink


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

    max_pixels: shrinks both until they have no more pixels than this.
    """
    camera, truth = photograph.camera, photograph.load()
    if max_pixels is not None and camera.width * camera.height > max_pixels:
        scale = (max_pixels / (camera.width * camera.height)) ** 0.5
        camera = camera.resized(max(1, int(camera.width * scale)), max(1, int(camera.height * scale)))
        truth = shrink(truth, camera.width, camera.height)
    rgb = np.asarray(jax.device_get(method.render(state, dataset.view_rays(camera)).rgb))
    rendered = np.clip(rgb.reshape(camera.height, camera.width, 3), 0.0, 1.0)
    return rendered, over_background(truth, dataset.background)


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
