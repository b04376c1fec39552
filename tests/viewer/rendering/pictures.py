"""How two pictures are compared: the tolerance of docs/rendering.md, and golden pictures with what a failure leaves behind."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import flip_evaluator
import numpy as np
import pytest
from PIL import Image

from tests.reference_marcher import render_reference
from tests.viewer.rendering.golden_variants import GOLDEN, ON_LLVMPIPE, compared, leave
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

FAILURES = Path(__file__).parents[2] / "failures"


def assert_same_picture(actual: np.ndarray, expected: np.ndarray, what: str = "") -> None:
    """docs/rendering.md, "Marchers": 1/255 per channel, but for at most 0.1 % of channels, at most 4/255. Pictures in [0, 1]."""
    difference = 255 * np.abs(actual.astype(np.float64) - expected)
    assert np.isfinite(actual).all(), what
    worst, share = difference.max(), np.mean(difference > 1.0)
    where = np.unravel_index(difference.argmax(), difference.shape)
    assert worst <= 4.0 and share <= 0.001, f"{what}: {worst:.2f}/255 at {where}, {100 * share:.3f} % beyond 1/255"


def assert_exact(
    renderer: OffscreenRenderer, camera: ViewCamera, wanted: RenderSettings | None = None, what: str = ""
) -> None:
    """brute and exact in OpenGL, each against the reference, and against one another."""
    wanted = wanted or RenderSettings()
    crop, radius = wanted.crop, renderer.pack.contraction
    if radius is not None and not wanted.surroundings:
        crop = ((-radius, -radius, -radius), (radius, radius, radius))
    near = max(camera.near, wanted.near)
    reference = render_reference(renderer.pack, replace(camera, near=near), background=wanted.background, crop=crop)
    brute, exact = (renderer.render_float(camera, replace(wanted, marcher=m)) for m in ("brute", "exact"))
    assert_same_picture(brute, reference.rgb, f"{what} brute")
    assert_same_picture(exact, reference.rgb, f"{what} exact")
    assert_same_picture(exact, brute, f"{what} exact and brute")


def differs(picture: np.ndarray, expected: np.ndarray) -> str:
    """How, where by more than ON_LLVMPIPE; "" where not."""
    found = compared(picture, expected, ON_LLVMPIPE)
    if found["within"]:
        return ""
    share = f"{100 * found['share']:.2f} % of channels beyond {ON_LLVMPIPE.channel}/255"
    return f"mean difference {found['mean']:.2f}/255, {share}, FLIP {flip(picture, expected):.3f}"


def flip(picture: np.ndarray, expected: np.ndarray) -> float:
    """The mean FLIP error."""
    return flip_evaluator.evaluate(expected / np.float32(255), picture / np.float32(255), "LDR")[1]


def compare_with_golden(
    config: pytest.Config,
    renderer: str,
    name: str,
    picture: np.ndarray,
    differs: Callable[[np.ndarray, np.ndarray], str] = differs,
) -> None:
    """Compares a uint8 [H, W, 3] picture with tests/golden/NAME.png, or rewrites that with --regenerate-golden.

    On failure tests/failures/ holds the actual picture, the expected one and their difference, amplified.
    """
    path = GOLDEN / f"{name}.png"
    if "llvmpipe" not in renderer:
        reason = f"golden pictures are compared on llvmpipe only, this is {renderer}"
        if config.getoption("--require-golden") or os.environ.get("CI"):
            pytest.fail(f"{reason}, and --require-golden (or CI) forbids to skip")
        pytest.skip(reason)
    if config.getoption("--regenerate-golden"):
        path.parent.mkdir(exist_ok=True)
        Image.fromarray(picture).save(path, optimize=True)
        return
    assert path.is_file(), f"{path} is missing; look at the picture, then run pytest --regenerate-golden"
    expected = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape == expected.shape, f"{name}: {picture.shape}, golden picture {expected.shape}"
    if not np.array_equal(picture, expected) and (problem := differs(picture, expected)):
        name = name.replace("/", "-")
        leave(FAILURES, name, picture, expected)
        pytest.fail(f"{name}: {problem}; see {FAILURES}/{name}-*.png")
