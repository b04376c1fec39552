"""Depth of field: the plane in focus is sharp, and everything else is blurred as by a thin lens."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenepack import Pack, save_pack
from tests.scenepack.volumes import cube_pack
from tests.viewer.commands.test_commands import picture, rendered
from viewer.rendering.camera import ViewCamera
from viewer.rendering.settings import Aperture, RenderSettings
from viewer.rendering.supersampling import lens_cameras

SIDE, BLOCK = 60, 15
NEAR_BAR, FAR_BAR = 0.5, -0.7  # z of two upright bars, left and right


def bars() -> Pack:
    z, y, x = np.mgrid[:SIDE, :SIDE, :SIDE] * (2 / SIDE) - 1 + 1 / SIDE
    rgba = np.zeros((SIDE, SIDE, SIDE, 4), np.uint8)
    for at, side in ((NEAR_BAR, -0.3), (FAR_BAR, 0.4)):
        rgba[(np.abs(x - side) < 0.15) & (np.abs(z - at) < 0.05) & (np.abs(y) < 0.8)] = (0, 0, 0, 255)
    return cube_pack(rgba, BLOCK)


def edge_widths(row: np.ndarray) -> tuple[float, float]:
    """How many pixels the left and the right bar's outer edge take to go from white to black, of a row of grey, 0 … 1."""
    left, right = np.array_split((row > 0.1) & (row < 0.9), 2)
    return float(left.sum()), float(right.sum())


@pytest.fixture(scope="module")
def renderer(offscreen):
    return offscreen(bars())


CAMERA = ViewCamera.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), fov_degrees=40.0, size=(240, 120))


def test_the_plane_in_focus_stays_sharp_and_the_rest_blurs_by_the_lens_equation(renderer) -> None:
    sharp = renderer.render(CAMERA)[60, :, 0] / 255
    widths = {}
    for name, focus in (("near", 3.0 - NEAR_BAR), ("far", 3.0 - FAR_BAR)):
        aperture = Aperture(0.4, focus, 256)
        widths[name] = edge_widths(renderer.render(CAMERA, RenderSettings(aperture=aperture))[60, :, 0] / 255)
    own = edge_widths(sharp)
    assert widths["near"][0] <= own[0] + 3 and widths["far"][1] <= own[1] + 3
    # the circle of confusion: diameter · f · |1 / depth - 1 / focus|, of which 10 … 90 % of light takes 0.69 across an edge
    confusion = 0.4 * CAMERA.fx * abs(1 / (3.0 - FAR_BAR) - 1 / (3.0 - NEAR_BAR))
    for found in (widths["near"][1], widths["far"][0]):
        assert found == pytest.approx(2 * 0.69 * confusion, rel=0.25), (found, confusion)


def test_the_picture_is_the_mean_of_exact_renders_from_the_lens(renderer) -> None:
    aperture = Aperture(0.3, 2.6, 9)
    cameras = lens_cameras(CAMERA, aperture)
    mean = np.mean([renderer.render_float(camera, RenderSettings(samples=2)) for camera in cameras], axis=0)
    found = renderer.render_float(CAMERA, RenderSettings(samples=2, aperture=aperture))
    assert np.abs(found - mean).max() < 1e-3 and np.abs(found - renderer.render_float(CAMERA)).max() > 0.2
    raw = renderer.render_raw(CAMERA, RenderSettings(raw=True, aperture=aperture))
    assert ((raw[..., 3] > 0.05) & (raw[..., 3] < 0.95)).sum() > 500  # opacity blurs with the colours
    depth = RenderSettings(mode="depth")
    assert np.array_equal(renderer.render(CAMERA, depth), renderer.render(CAMERA, replace(depth, aperture=aperture)))


def test_the_command_focuses_on_the_middle_or_at_a_distance(tmp_path: Path) -> None:
    save_pack(bars(), tmp_path / "bars")
    words = ["--eye", "-0.3,0,3", "--target", "-0.3,0,0", "--size", "240x120", "--aperture", "0.4"]
    pictures = {}
    for name, more in (("middle", []), ("far", ["--focus", str(3.0 - FAR_BAR)])):
        seen = picture(rendered(tmp_path / "bars", tmp_path / f"{name}.png", *words, *more))
        pictures[name] = seen[60, :, 0] / 255.0
    assert edge_widths(pictures["middle"])[0] < edge_widths(pictures["far"])[0] - 3
