"""Depth of field of the stills that the window saves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.viewer.commands.test_commands import picture
from tests.viewer.rendering.test_depth_of_field import CAMERA, FAR_BAR, bars, edge_widths
from viewer.app.application import App
from viewer.core.pose import Pose
from viewer.features.film.filming import Filming


def test_a_still_of_the_window_is_blurred_and_a_click_chooses_the_focus(offscreen, app: App, tmp_path: Path) -> None:
    ui = offscreen(app, size=(1000, 700))
    app.show(bars(), Path("bars"))
    rig, filming = app.scene.rig, app.filming
    rig.goal = rig.shown = Pose((-0.3, 0.0, 0.0), 0.0, 0.0, 3.0)
    rig.fov = 40.0
    app.interface.page = "film"
    ui.settle()
    filming.size, filming.aperture, filming.lens_rays = (240, 120), 0.3, 64

    def still(name: str) -> np.ndarray:
        filming.still(app, tmp_path / name)
        while filming.export is not None:
            app.tick(0.01)
        assert not app.messages.dialogs, app.messages.dialogs
        return picture(tmp_path / name)[60, :, 0] / 255.0

    middle = edge_widths(still("middle.png"))
    filming.focusing = True
    x, y = app.viewport.x + app.viewport.width / 2, app.viewport.y + app.viewport.height / 2
    ui.click(x + 0.7 * CAMERA.fx * app.viewport.height / 120 / (3.0 - FAR_BAR), y)  # the far bar
    assert not filming.focusing and filming.focus is not None and abs(filming.focus[2] - FAR_BAR) < 0.1
    far = edge_widths(still("far.png"))
    assert middle[0] < far[0] - 3 and far[1] < middle[1] - 3
    rig.set_orthographic(True)
    with pytest.raises(Exception, match="perspective"):
        filming.still(app, tmp_path / "flat.png")
    assert not Filming(focus=(0.0, 0.0, 0.0)).of_another_scene().focus
