"""How two pictures are compared: the tolerance of docs/rendering.md, and golden pictures with what a failure leaves behind."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

GOLDEN = Path(__file__).parents[2] / "golden"
FAILURES = Path(__file__).parents[2] / "failures"
# Drivers round differently; a golden picture is to catch what an eye would, on the one rasteriser it was made with.
MEAN_TOLERANCE, CHANNEL_TOLERANCE, SHARE_BEYOND = 0.5, 8, 1e-3
AMPLIFIED = 8


def assert_same_picture(actual: np.ndarray, expected: np.ndarray, what: str = "") -> None:
    """docs/rendering.md, "Marchers": 1/255 per channel, but for at most 0.1 % of channels, at most 4/255. Pictures in [0, 1]."""
    difference = 255 * np.abs(actual.astype(np.float64) - expected)
    assert np.isfinite(actual).all(), what
    worst, share = difference.max(), np.mean(difference > 1.0)
    where = np.unravel_index(difference.argmax(), difference.shape)
    assert worst <= 4.0 and share <= 0.001, f"{what}: {worst:.2f}/255 at {where}, {100 * share:.3f} % beyond 1/255"


def must_not_skip(config: pytest.Config) -> bool:
    return bool(config.getoption("--require-golden") or os.environ.get("CI"))


def skip(config: pytest.Config, reason: str) -> None:
    """Skips, or fails where nothing may be skipped silently."""
    if must_not_skip(config):
        pytest.fail(f"{reason}, and --require-golden (or CI) forbids to skip")
    pytest.skip(reason)


def compare_with_golden(config: pytest.Config, renderer: str, name: str, picture: np.ndarray) -> None:
    """Compares a uint8 [H, W, 3] picture with tests/golden/NAME.png, or rewrites that with --regenerate-golden.

    On failure tests/failures/ holds the actual picture, the expected one and their difference, amplified.
    """
    path = GOLDEN / f"{name}.png"
    if "llvmpipe" not in renderer:
        skip(config, f"golden pictures are compared on llvmpipe only, this is {renderer}")
    if config.getoption("--regenerate-golden"):
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(picture).save(path, optimize=True)
        return
    assert path.is_file(), f"{path} is missing; look at the picture, then run pytest --regenerate-golden"
    expected = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape == expected.shape, f"{name}: {picture.shape}, golden picture {expected.shape}"
    difference = np.abs(picture.astype(int) - expected)
    mean, share = difference.mean(), np.mean(difference > CHANNEL_TOLERANCE)
    if mean <= MEAN_TOLERANCE and share <= SHARE_BEYOND:
        return
    FAILURES.mkdir(exist_ok=True)
    Image.fromarray(picture).save(FAILURES / f"{name}-actual.png")
    Image.fromarray(expected).save(FAILURES / f"{name}-expected.png")
    amplified = np.clip(AMPLIFIED * difference, 0, 255).astype(np.uint8)
    Image.fromarray(amplified).save(FAILURES / f"{name}-difference-x{AMPLIFIED}.png")
    pytest.fail(
        f"{name}: mean difference {mean:.2f}/255, {100 * share:.2f} % of channels beyond {CHANNEL_TOLERANCE}/255"
        f"{_flip(picture, expected)}; see {FAILURES}/{name}-*.png"
    )


def _flip(picture: np.ndarray, expected: np.ndarray) -> str:
    """The mean FLIP error, where flip-evaluator is installed."""
    try:
        import flip_evaluator
    except ImportError:
        return ""
    _, mean, _ = flip_evaluator.evaluate(expected / np.float32(255), picture / np.float32(255), "LDR")
    return f", FLIP {mean:.3f}"
