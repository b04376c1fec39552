"""What is trained so far: shown as it comes, with the camera where the hands put it, and never in place of something else."""

import pytest

from scenepack import save_pack
from tests.viewer.waiting import live
from viewer.app.application import App
from viewer.features.making.make_job import preview_title


@pytest.fixture
def write(tmp_path, pack):
    """Writes what is trained after so many steps, as the child does."""

    def call(steps: int) -> None:
        made = {"steps": steps, "of_steps": 6000, "preview": True}
        save_pack(pack.with_metadata(provenance=made), tmp_path / "preview.zip")

    return call


def came(app: App, steps: int) -> bool:
    return app.making.job.preview is not None and f" {steps:,} " in preview_title(app.making.job.preview)


def test_what_is_trained_so_far_is_shown_by_itself_and_then_the_pack_while_the_camera_stays(making, write, tmp_path):
    app = making("until-told")
    live(app, lambda: app.making.job.report is not None)
    assert app.scene is None
    write(1200)
    live(app, lambda: came(app, 1200))
    assert app.scene.name == "photographs: preview after 1,200 steps" and app.making.training_preview_shown(app)
    assert app.canvas.shown == [app.making.job.preview] and app.preferences.recent == []
    untouched = app.scene.rig.goal
    app.scene.rig.orbit(80.0, 15.0)
    chosen, fov = app.scene.rig.goal, app.fov
    assert chosen != untouched
    live(app, lambda: app.scene.rig.shown == app.scene.rig.goal)
    write(2400)
    live(app, lambda: came(app, 2400))
    assert app.scene.name.endswith("2,400 steps") and app.scene.pack is app.making.job.preview
    assert app.scene.rig.goal == app.scene.rig.shown == chosen
    assert app.canvas.shown == [app.making.job.preview], "refined in place: nothing is blank in between"
    (tmp_path / "go").touch()
    live(app, lambda: app.making.job is None and app.loading is None)
    assert app.scene.path == tmp_path / "pack" and not app.messages.dialogs
    assert app.scene.rig.goal == chosen and app.fov == fov


def test_a_scene_that_is_open_is_not_taken_away(making, write, pack, pack_folder):
    app = making("until-told")
    app.show(pack, pack_folder)
    write(1200)
    live(app, lambda: came(app, 1200))
    assert app.scene.path == pack_folder and not app.making.training_preview_shown(app)
    app.making.show_training_preview(app)
    assert app.making.training_preview_shown(app)
    app.show(pack, pack_folder)
    write(2400)
    live(app, lambda: came(app, 2400))
    assert app.scene.path == pack_folder, "whoever has gone elsewhere stays there"
