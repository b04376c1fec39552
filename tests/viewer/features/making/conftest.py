"""Photographs and a stand-in for snerg-make that the tests of making a scene share."""

import shutil
import sys
from pathlib import Path

import pytest

from tests.viewer.app.test_application import FakeCanvas
from tools.procedural import write_procedural_scene
from viewer.app.application import App
from viewer.features.making.make_plan import Plan

FAKE = Path(__file__).with_name("fake_make.py")
ROOT = FAKE.parents[4]


@pytest.fixture(scope="session")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_procedural_scene(tmp_path_factory.mktemp("photographs") / "still", size=24, views=3, subpixels=1)


@pytest.fixture
def making(monkeypatch, tmp_path, pack_folder):
    """An app whose plan runs the stand-in: making("wait") begins it."""
    shutil.copytree(pack_folder, tmp_path / "source")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    app = App(canvas=FakeCanvas())

    def begin(how: str) -> App:
        command = [sys.executable, str(FAKE), how, str(tmp_path)]
        monkeypatch.setattr(Plan, "command", lambda plan: command)
        app.making.plan = Plan("scene", tmp_path / "photographs", tmp_path)
        app.making.start(app)
        return app

    yield begin
    app.making.end()
