"""Picture quality: PSNR and SSIM, and means of scores; for LPIPS see baker.lpips.

Notation: a, b [H, W, 3] pictures in [0, 1]. SSIM (Wang et al. 2004) as tf.image.ssim has it: an 11 x 11 Gaussian window of
sigma 1.5, K1 = 0.01, K2 = 0.03, peak 1, only windows that lie wholly inside ("valid"), the mean over channels.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
blur = partial(gaussian_filter, sigma=SIGMA, radius=WINDOW // 2, axes=(0, 1))


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of the mean squared error over all pixels."""
    error = np.square(np.asarray(a, np.float64) - np.asarray(b, np.float64))
    return float(-10.0 * np.log10(max(error.mean(), 1e-12)))


def colours_matched(picture: np.ndarray, truth: np.ndarray, where: np.ndarray) -> np.ndarray:
    """The picture [H, W, 3], over the pixels `where` bool [H, W], with the gain and offset of each channel that bring it
    nearest to `truth` by least squares: what a camera's exposure and white balance may change."""
    matched = np.array(picture, np.float64)
    for channel in range(3 if where.any() else 0):
        shown = matched[where, channel]
        basis = np.stack([shown, np.ones_like(shown)], axis=-1)
        fit = np.linalg.lstsq(basis, np.asarray(truth, np.float64)[where, channel], rcond=None)[0]
        matched[where, channel] = np.clip(basis @ fit, 0.0, 1.0)
    return matched


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Structural similarity, at most 1. Pictures must be at least 11 pixels a side."""
    if min(a.shape[:2]) < WINDOW:
        raise ValueError(f"SSIM needs pictures of at least {WINDOW} pixels a side, not {a.shape[1]}x{a.shape[0]}")
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    mean_a, mean_b = blur(a), blur(b)
    # second moments less squared means: tf.image.ssim does not clamp them either
    variances = blur(a * a + b * b) - mean_a**2 - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
    structure = (2 * covariance + C2) / (variances + C2)
    inside = slice(WINDOW // 2, -(WINDOW // 2))  # where windows lie inside the picture
    return float((luminance * structure)[inside, inside].mean())


def mean(values: Sequence[float | None]) -> float | None:
    """Of scores; None where one is not known."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known and len(known) == len(values) else None
