"""Exposures of photographs: gains fitted from what photographs and field show, and pictures that are matched to compare."""

import numpy as np
import pytest

from baker.metrics import colours_matched, psnr
from training.exposure import fitted

VIEWS, RAYS = 12, 400


def shown(gains: np.ndarray, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a field shows of rays, their opacity, and the pixels of photographs with these gains [V, 3]."""
    rng = np.random.default_rng(0)
    look = rng.uniform(0.1, 0.7, (len(gains), RAYS, 3))
    opacity = rng.uniform(0.8, 1.0, look.shape[:2])
    photographs = gains[:, None] * look + rng.normal(0, noise, look.shape)
    return look * opacity[..., None], opacity, np.rint(255 * np.clip(photographs, 0, 1)).astype(np.uint8)


def some_gains() -> np.ndarray:
    return np.random.default_rng(1).uniform(0.75, 1.25, (VIEWS, 3))


def after(times: int, rays: tuple[np.ndarray, np.ndarray, np.ndarray], *, auto: bool = True) -> np.ndarray:
    gains = np.ones((len(rays[0]), 3), np.float32)
    for _ in range(times):
        gains = fitted(gains, *rays, auto=auto)
    return gains


def test_gains_are_found_at_once_up_to_what_all_photographs_share() -> None:
    right = some_gains()
    found = after(1, shown(right))
    np.testing.assert_allclose(np.log(found).mean(0), 0, atol=1e-5)
    relative = np.log(right) - np.log(right).mean(0)
    assert np.abs(np.log(found) - relative).max() < 0.03
    np.testing.assert_allclose(after(1, shown(np.full((5, 3), 0.8)), auto=False), 1.0, atol=0.02)


def test_clipped_and_clear_pixels_and_rays_through_air_tell_nothing() -> None:
    right = some_gains()
    look, opacity, pixels = shown(right)
    pixels = np.concatenate([pixels, np.full((*pixels.shape[:2], 1), 255, np.uint8)], -1)
    expected = after(1, (look[:, 60:], opacity[:, 60:], pixels[:, 60:]))
    pixels[:, :20] = 255
    pixels[:, 20:40, 3] = 0
    opacity[:, 40:60] = 0.1
    np.testing.assert_allclose(after(1, (look, opacity, pixels)), expected, atol=1e-6)


def test_a_picture_is_matched_to_its_photograph_by_gain_and_offset_and_by_no_more() -> None:
    rng = np.random.default_rng(2)
    truth = rng.uniform(0.2, 0.7, (8, 9, 3))
    where = np.ones((8, 9), bool)
    where[:2] = False
    shown = np.where(where[..., None], truth * [0.8, 0.9, 1.2] + [0.05, 0.0, -0.05], truth)
    assert psnr(shown, truth) < 30
    assert psnr(colours_matched(shown, truth, where), truth) > 100
    np.testing.assert_array_equal(colours_matched(shown, truth, np.zeros((8, 9), bool)), shown)
    blurred = truth.mean((0, 1)) + 0 * truth
    assert psnr(colours_matched(blurred, truth, where), truth) == pytest.approx(psnr(blurred, truth), abs=0.5)
