"""What a validation compares: the pixels of the photographs themselves, however many there are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from training.dataset import make_dataset
from training.method import Rays
from training.recorder import render_photograph
from training.scenes.scene import Scene


class Seer:
    """A method that knows what every ray shows: the colour of its direction."""

    def render(self, state: Any, rays: Rays) -> SimpleNamespace:
        return SimpleNamespace(rgb=0.5 + 0.5 * np.sin(40 * np.asarray(rays.viewdirs)))


@pytest.mark.parametrize(
    ("most", "size"), [(None, (48, 48)), (48 * 48, (48, 48)), (2000, (24, 24)), (300, (16, 16)), (1, (1, 1))]
)
def test_of_a_large_photograph_some_pixels_are_compared_and_none_is_shrunk(
    procedural_scene: Scene, most: int | None, size: tuple[int, int]
) -> None:
    dataset, camera = make_dataset(procedural_scene), procedural_scene.splits["test"][0].camera
    picture = Seer().render(None, dataset.view_rays(camera)).rgb.reshape(camera.height, camera.width, 3)
    opaque = np.concatenate([picture, np.ones_like(picture[..., :1])], -1)
    photograph: Any = SimpleNamespace(camera=camera, load=lambda: opaque)
    rendered, truth = render_photograph(Seer(), None, dataset, photograph, most)  # type: ignore[arg-type]
    assert rendered.shape == truth.shape == (*size, 3) and picture.std() > 0.3
    np.testing.assert_allclose(rendered, truth, atol=1e-6)
