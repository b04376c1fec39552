"""A bake before it is quantised: rounded it is the pack, and it is drawn by the pack's rules."""

import dataclasses

import numpy as np
import pytest

from baker.baking.bake import bake, bake_floats
from baker.baking.config import BakeConfig
from baker.baking.grid import FloatGrid
from baker.reports.float_pictures import float_pictures
from tests.reference_marcher import render_reference
from tests.stored_runs import SCENE, STORED
from training.run import Run, load_run
from viewer.rendering.camera import ViewCamera

CONFIG = BakeConfig(resolution=45, preset="paper", quality="draft")


@pytest.fixture(scope="module")
def run() -> Run:
    """Of an older version, so that nothing is trained here."""
    return load_run(STORED / "nerf", scene_path=SCENE)


@pytest.fixture(scope="module")
def floats(run: Run) -> FloatGrid:
    return bake_floats(run, CONFIG)


def test_what_is_rounded_is_drawn_as_the_reference_draws_the_pack_and_what_is_not_differs(run, floats):
    pack = bake(run, CONFIG)
    assert floats.bytes == 32 * pack.atlas_rgba[..., 0].size
    camera = run.scene.splits["test"][0].camera
    values = np.round(255 * floats.values) / np.float32(255)
    values[values[:, 3] == 0] = 0
    rounded = dataclasses.replace(floats, values=values.astype(np.float32))
    wanted = render_reference(pack, ViewCamera.from_scene_camera(pack, camera))
    for mode, picture in (("normal", wanted.rgb), ("alpha", wanted.alpha)):
        difference = np.abs(float_pictures(rounded, run).show(camera, mode) - picture)  # type: ignore[arg-type]
        assert np.quantile(difference, 0.999) < 1 / 255 and difference.max() < 0.05, mode
    unrounded = float_pictures(floats, run).show(camera, "normal")
    assert 1e-5 < np.mean(np.abs(unrounded - wanted.rgb)) < 0.05
