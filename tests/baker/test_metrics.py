"""PSNR and SSIM as the field computes them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from baker.metrics import psnr, ssim

rng = np.random.default_rng(0)
A, B = rng.random((40, 33, 3)), rng.random((40, 33, 3))


def test_psnr_of_known_errors():
    assert psnr(np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 0.6)) == pytest.approx(20)
    assert psnr(A, A) == pytest.approx(120)


def test_masked_psnr_sees_the_mask_alone():
    wrong = A.copy()
    wrong[:20] += 0.3
    mask = np.zeros(A.shape[:2], bool)
    mask[20:] = True
    assert psnr(wrong, A, mask) == pytest.approx(120)


def test_ssim_is_one_for_equal_pictures_and_symmetric():
    assert ssim(A, A) == pytest.approx(1)
    assert ssim(A, B) == pytest.approx(ssim(B, A))


def test_ssim_equals_the_definition_through_another_gaussian_filter():
    def mean(x):
        # radius 5 and the same sigma: scipy's window is ours; cropping leaves the windows inside
        return np.stack([gaussian_filter(x[..., c], 1.5, radius=5)[5:-5, 5:-5] for c in range(3)], -1)

    a, b = A, 0.5 * A + 0.5 * B
    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    value = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    assert ssim(a, b) == pytest.approx(value.mean(), abs=1e-9)
