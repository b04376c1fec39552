"""What was mended in a pack from elsewhere is said once, in the window; toasts come and go without drawing on."""

import json
from pathlib import Path

import pytest

from scenepack import save_pack
from tests.viewer.app.test_application import FakeCanvas, finish_loading
from viewer.app.application import App


@pytest.fixture
def untidy(pack, tmp_path) -> Path:
    """A pack made elsewhere: its features are missing, and a number is wrong."""
    folder = tmp_path / "untidy"
    save_pack(pack, folder)
    for file in folder.glob("feature_*"):
        file.unlink()
    params = json.loads((folder / "scene_params.json").read_text())
    params["atlas_blocks_x"] += 1
    (folder / "scene_params.json").write_text(json.dumps(params))
    return folder


def opened(app: App, path: Path) -> str:
    """The toast once the pack is open."""
    app.messages.toast = ""
    app.open(path)
    finish_loading(app)
    return app.messages.toast


def test_what_was_mended_is_shown_once_and_stays_in_the_log(untidy, pack_folder):
    app = App(canvas=FakeCanvas())
    assert opened(app, pack_folder) == ""  # a sound pack
    notice = opened(app, untidy)
    assert "atlas_blocks" in notice and "feature_000.png is missing" in notice and app.messages.toast_level == "warning"
    assert str(untidy) not in notice and app.messages.toast_left > 5
    assert opened(app, untidy) == ""
    assert sum("feature_000.png" in line.text for line in app.messages.lines) == 2
    params = json.loads((untidy / "scene_params.json").read_text())
    (untidy / "scene_params.json").write_text(json.dumps({**params, "atlas_blocks_x": 99}))
    again = opened(app, untidy)
    assert "feature_000.png" not in again and again  # only what is new
