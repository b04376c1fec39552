"""How much different exposures cost, and how much of it is won back: trains a scene as it is, and with synthetic gains, with and
without training.exposure.

    python scripts/exposures.py SCENE [--downscale K] [--steps N] [--spread 0.2]

Gains are drawn evenly from 1 - spread to 1 + spread for each training photograph, and from 0.9 to 1.1 for each channel of
it. What is held out stays as it is. The fields are small, so that it takes minutes. Prints the PSNR (dB) of the held-out
views, as they are and matched (snerg-eval).
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from baker.metrics import colours_matched, psnr
from training.config import QUICK
from training.dataset import RayDataset, make_dataset
from training.exposure import Choice
from training.multires.config import MultiresConfig
from training.run import make_method
from training.scenes import Scene, load_scene
from training.scenes.pictures import over_background

SMALL = dataclasses.replace(
    QUICK, engine="fused", multires=MultiresConfig(resolutions=(16, 32, 64), occupancy=64, samples_per_step=16_384)
)


def flickering(dataset: RayDataset, spread: float) -> RayDataset:
    """The dataset as cameras would have taken it that meter every photograph anew."""
    rng, views = np.random.default_rng(3), dataset.views
    logs = np.log(rng.uniform(1 - spread, 1 + spread, (views, 1)) * rng.uniform(0.9, 1.1, (views, 3)))
    gains = np.exp(logs - logs.mean(0))
    pixels, ends = np.array(dataset.pixels), np.append(np.asarray(dataset.first), dataset.count)
    for gain, low, high in zip(gains, ends[:-1], ends[1:], strict=True):
        pixels[low:high, :3] = np.rint(np.clip(pixels[low:high, :3] * gain, 0, 255))
    return dataclasses.replace(dataset, pixels=jnp.asarray(pixels))


def scores(scene: Scene, dataset: RayDataset, exposure: Choice, steps: int) -> tuple[float, float]:
    """PSNR (dB) of the held-out views: as they are, and matched."""
    method = make_method(dataclasses.replace(SMALL, steps=steps, exposure=exposure), dataset)
    state = method.start(jax.random.key(0))
    for step in range(steps):
        state, _ = method.step(state, step)
    plain, matched = [], []
    for view in scene.splits["test"]:
        photograph = view.load()
        truth = over_background(photograph, scene.background)
        shown = np.asarray(method.render(state, dataset.view_rays(view.camera)).rgb)
        picture = np.clip(shown, 0, 1).reshape(truth.shape)
        plain.append(psnr(picture, truth))
        matched.append(psnr(colours_matched(picture, truth, photograph[..., 3] > 0.5), truth))
    return float(np.mean(plain)), float(np.mean(matched))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--downscale", type=int, default=1)
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--spread", type=float, default=0.2)
    options = parser.parse_args()
    scene = load_scene(options.scene, downscale=options.downscale)
    dataset = make_dataset(scene)
    for name, photographs in (("as it is", dataset), ("with gains", flickering(dataset, options.spread))):
        for exposure in ("off", "auto", "on"):
            plain, matched = scores(scene, photographs, exposure, options.steps)
            print(f"{name}, --exposure {exposure}: {plain:.2f} dB, {matched:.2f} dB matched", flush=True)


if __name__ == "__main__":
    main()
