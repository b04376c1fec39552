"""Making a scene from the window: what the child process does, what is shown of it, and that it never outlives us."""

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image

from console import child_process
from scenepack import Pack, save_pack
from tests.training.posing.conftest import COUNT, write_photographs
from tests.training.posing.rooms import cameras, panorama_cameras, photograph
from tests.training.reconstructions import ball, write_colmap
from tests.training.test_captures import circle, write_transforms
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.features.making.conftest import FAKE, ROOT
from tests.viewer.offscreen_ui import drawn_widths
from tests.viewer.waiting import is_gone, live, not_none, until
from tools.procedural import write_procedural_scene
from training.config import PRESETS
from training.posing import find
from training.scenes.presets import BakeablePreset
from viewer.app.application import App
from viewer.core.files import POSED, REPORT
from viewer.features.making import survey
from viewer.features.making.make_job import preview_title
from viewer.features.making.make_plan import Plan
from viewer.features.making.panel import what_it_needs
from viewer.features.making.survey import Survey, result_lines


def test_progress_is_shown_while_the_child_works(making):
    app = making("wait")
    live(app, lambda: app.making.job.child.report is not None and app.making.job.child.report.done == 40)
    job = app.making.job
    assert job.stage == 1 and job.figures == [21.5] and job.child.report.share == 0.4
    assert job.warnings == ["a photograph is left out"]
    (job.plan.run / "validation").mkdir(parents=True)
    Image.new("RGB", (1024, 512), (200, 10, 10)).save(job.plan.run / "validation" / "latest.png")
    live(app, lambda: job.picture is not None)
    assert job.picture.shape == (256, 512, 3)


@pytest.mark.parametrize("how", ["wait", "deaf"])
def test_stopping_lets_the_child_save_and_ends_one_that_does_not_hear_when_asked_again(making, tmp_path, how):
    app = making(how)
    live(app, (tmp_path / "pid").exists)
    pid = int((tmp_path / "pid").read_text())
    for _ in range(1 if how == "wait" else 2):
        app.making.stop()
    assert app.making.job.child.stopping
    live(app, lambda: app.making.job is None)
    assert is_gone(pid) and not app.messages.dialogs and "make it again" in app.messages.toast
    assert (tmp_path / "saved").exists() == (how == "wait")
    assert ("saved at step 40" in (tmp_path / "make.log").read_text()) == (how == "wait")


def test_a_failure_is_a_dialog_with_its_line_and_its_log_and_can_be_tried_again(making, tmp_path):
    app = making("fail")
    live(app, lambda: app.making.job is None)
    dialog = app.messages.dialogs[0]
    assert "could not be made" in dialog.title
    assert dialog.text.startswith(f"{tmp_path}: the folder is empty; choose another")
    assert str(tmp_path / "make.log") in dialog.text and "Traceback" not in dialog.text
    app.messages.dialogs.clear()
    assert app.run("make-again") and app.making.plan.source == tmp_path / "photographs"


def test_quitting_asks_first_and_leaves_no_child(making, tmp_path):
    app = making("wait")
    live(app, (tmp_path / "pid").exists)
    pid = int((tmp_path / "pid").read_text())
    app.run("quit")
    app.run("quit")
    assert not app.quitting and len(app.messages.dialogs) == 1
    answers = dict(app.messages.dialogs.pop().buttons)
    app.run(answers["Stop and quit"])
    live(app, lambda: app.quitting)
    assert (tmp_path / "saved").exists() and is_gone(pid)
    assert App().run("quit")


def test_a_viewer_that_is_killed_leaves_no_child(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from viewer.core.tasks import CommandProcess\n"
        f"CommandProcess([sys.executable, {str(FAKE)!r}, 'wait', {str(tmp_path)!r}], Path({str(tmp_path / 'log')!r}))\n"
        "time.sleep(60)"
    )
    viewer = subprocess.Popen([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)})
    until((tmp_path / "pid").exists)
    viewer.send_signal(signal.SIGKILL)
    viewer.wait()
    until((tmp_path / "saved").exists)


@pytest.mark.slow
def test_photographs_become_a_scene_through_the_real_programs_even_when_stopped_between(scene, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr(child_process, "POLITENESS", 0)  # other tests would go first
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "compiled"))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    app = App(canvas=FakeCanvas())

    def begin(steps: int) -> None:
        app.drop([scene])
        plan = not_none(app.making.plan)
        plan.choose(tmp_path / "made")
        plan.preset, plan.steps, plan.resolution = "tiny", steps, 32
        app.making.start(app)

    begin(100_000)
    try:
        live(
            app, lambda: app.making.job is None or getattr(app.making.job.child.report, "stage", "") == "training", 300
        )
        app.making.stop()  # while its first step is being compiled
        live(app, lambda: app.making.job is None, 300)
        assert not app.messages.dialogs and "was stopped" in app.messages.toast
        assert list((tmp_path / "made" / "run" / "checkpoints").glob("*.safetensors"))
        begin(1)  # as many as are done
        live(app, lambda: app.making.job is None and app.loading is None, 300)
    finally:
        app.making.end()
    assert not app.messages.dialogs and app.open_scene.path == tmp_path / "made" / "pack"


def train(app: App, pack: Pack, steps: int) -> None:
    """Writes what is trained after so many steps, as the child does, and waits until it has come."""
    job, made = not_none(app.making.job), {"steps": steps, "of_steps": 6000, "preview": True}
    save_pack(pack.with_metadata(provenance=made), job.plan.out / "preview.zip")
    live(app, lambda: job.preview is not None and f" {steps:,} " in preview_title(job.preview))


def test_what_is_trained_so_far_is_shown_by_itself_and_then_the_pack_while_the_camera_stays(making, pack, tmp_path):
    app = making("until-told")
    live(app, lambda: app.making.job.child.report is not None)
    assert app.scene is None
    train(app, pack, 1200)
    assert app.open_scene.name == "photographs: preview after 1,200 steps" and app.making.training_preview_shown(app)
    assert app.canvas.shown == [app.making.job.preview] and app.preferences.recent == []
    untouched = app.open_scene.rig.goal
    app.open_scene.rig.orbit(80.0, 15.0)
    chosen, fov = app.open_scene.rig.goal, app.open_scene.rig.fov
    assert chosen != untouched
    live(app, lambda: app.scene.rig.shown == app.scene.rig.goal)
    train(app, pack, 2400)
    assert app.open_scene.name.endswith("2,400 steps") and app.open_scene.pack is app.making.job.preview
    assert app.open_scene.rig.goal == app.open_scene.rig.shown == chosen
    assert app.canvas.shown == [app.making.job.preview], "refined in place: nothing is blank in between"
    (tmp_path / "go").touch()
    live(app, lambda: app.making.job is None and app.loading is None)
    assert app.open_scene.path == tmp_path / "pack" and not app.messages.dialogs
    assert app.open_scene.rig.goal == chosen and app.open_scene.rig.fov == fov


def test_a_scene_that_is_open_is_not_taken_away(making, pack, pack_folder):
    app = making("until-told")
    app.show(pack, pack_folder)
    train(app, pack, 1200)
    assert app.scene.path == pack_folder and not app.making.training_preview_shown(app)
    app.making.show_training_preview(app)
    assert app.making.training_preview_shown(app)
    app.show(pack, pack_folder)
    train(app, pack, 2400)
    assert app.scene.path == pack_folder, "whoever has gone elsewhere stays there"


SHOTS, DARK = 8, 4


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """An app whose dialog asks about photographs, one of them darker than the others."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "shed").mkdir()
    for i, camera in enumerate(cameras(SHOTS)):
        picture = Image.fromarray(photograph(camera)).point(lambda v, light=0.6 if i == DARK else 1.0: int(v * light))
        picture.save(tmp_path / "shed" / f"p{i}.png")
    app, *_ = dropped(tmp_path / "shed")
    yield app
    app.making.end()


@pytest.mark.slow
def test_a_check_shows_its_progress_and_then_what_it_found(asked: App, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    making, opened = asked.making, []
    making.check_photographs(asked)
    check = making.check
    assert check is not None and check.running and making.busy
    live(asked, lambda: check.child.report is not None)
    assert not_none(check.child.report).stage == "check"
    live(asked, lambda: not check.running)
    assert not check.error and check.result is not None
    assert list(check.result["differently_exposed"]) == [f"p{DARK}.png"] and not check.result["set_aside"]
    assert check.page == tmp_path / "shed-snerg" / "check.html" and check.page.is_file()
    lines = [text for text, _ in result_lines(check.result)]
    assert lines[0].startswith(f"{SHOTS} photographs, ")
    assert lines[-1].startswith(f"1 differently exposed: p{DARK}.png (")
    monkeypatch.setattr(survey.webbrowser, "open", lambda address: opened.append(address))  # and finds none
    check.open_page()
    live(asked, lambda: "No browser was found" in asked.messages.toast)
    assert opened == [check.page.as_uri()]
    making.dismiss()
    assert making.check is None


def test_a_check_whose_dialog_is_closed_is_stopped_and_leaves_nothing(asked: App, tmp_path: Path):
    asked.making.check_photographs(asked)
    check = not_none(asked.making.check)
    live(asked, lambda: check.child.report is not None)
    pid = check.child._child.pid
    asked.making.dismiss()  # which stops it first
    assert asked.making.check is None
    live(asked, lambda: is_gone(pid) and not list((tmp_path / "temporary").glob("snerg-ch*")))
    assert not (tmp_path / "shed-snerg").exists() and not asked.messages.dialogs


def test_a_check_that_fails_says_why_in_one_line(asked: App, tmp_path: Path):
    shutil.rmtree(tmp_path / "shed")
    asked.making.check_photographs(asked)
    check = not_none(asked.making.check)
    live(asked, lambda: not check.running)
    assert check.result is None and check.error.startswith(f"{tmp_path / 'shed'}: no such file or folder")


def dropped(path: Path) -> tuple[App, Plan, Survey]:
    """An app whose dialog asks about `path`; how it would be made; the survey of its photographs, which is finished."""
    app = App(canvas=FakeCanvas())
    app.drop([path])
    plan = not_none(app.making.plan)
    survey = not_none(plan.survey)
    until(lambda: survey.finished)
    return app, plan, survey


def test_a_scene_that_is_dropped_is_asked_about(scene):
    app, plan, found = dropped(scene)
    assert plan.subject == "scene" and plan.out == scene.parent / "still-snerg"
    assert found.text.startswith("5 photographs of 24 × 24") and "Blender" in found.text
    assert plan.problem() is None
    plan.downscale, plan.preset = 2, "full"
    assert found.size("full", 2) == (12, 12)
    assert plan.typed() == f"snerg-make {scene} --out {plan.out} --preset full --downscale 2"
    assert "--no-view" in plan.command()
    app.making.dismiss()
    assert app.making.plan is None and not app.messages.dialogs


def test_poses_that_are_there_can_be_found_anew(tmp_path):
    write_photographs(tmp_path / "walk")
    (tmp_path / "walk" / "transforms.json").write_text('{"frames": []}')
    _, plan, found = dropped(tmp_path / "walk")
    assert found.posed and plan.stages[0] == "Training"
    plan.find_anew(True)
    until(lambda: not_none(plan.survey).finished)
    assert found.cancelled and plan.stages[0] == "Poses" and "--find-poses" in plan.typed()
    plan.find_anew(False)
    assert "--find-poses" not in plan.typed()


def test_the_commands_are_ones_that_the_real_programs_take(scene, tmp_path, monkeypatch):
    from baker.commands import bake, make

    made = Plan("scene", scene, tmp_path, "full", downscale=2, spherify=True, masks=True, steps=5, resolution=96)
    for plan, module, name in ((made, make, "snerg_make"), (Plan("run", scene, tmp_path / "p"), bake, "snerg_bake")):
        assert plan.command()[1:5] == ["-P", "-m", "snerg", module.__name__.split(".")[-1]]
        called = {}
        real = getattr(module, name)
        stand_in = functools.wraps(real)(lambda *words, **options: called.update(options))  # noqa: B023
        monkeypatch.setattr(module, name, stand_in)
        assert module.main(plan.command()[5:]) == 0
        assert called["out"] == plan.out
        if plan.subject == "scene":
            assert called["no_view"] and called["masks"] and called["spherify"] and called["preset"] == "full"
            assert (called["downscale"], called["steps"], called["resolution"]) == (2, 5, 96)
    monkeypatch.undo()
    assert set(survey.OFFERED) <= set(get_args(BakeablePreset))


def test_a_broken_scene_is_told_before_anything_is_begun(tmp_path):
    (tmp_path / "transforms_train.json").write_text('{"frames": []}')
    app, plan, _ = dropped(tmp_path)
    assert str(tmp_path) in not_none(plan.problem())
    app.making.start(app)
    assert app.making.job is None and app.making.plan is not None


def test_the_viewer_alone_says_what_is_missing(scene, monkeypatch, tmp_path):
    monkeypatch.setattr(survey.importlib.util, "find_spec", lambda name: None)
    assert "pip install 'snerg[train]'" in not_none(Plan("scene", scene, tmp_path).problem())


def photographs(folder: Path, count: int = 8) -> Path:
    """A folder of pictures, and nothing that says where the camera stood."""
    folder.mkdir()
    for i in range(count):
        Image.new("RGB", (1200, 900), (25 * i, 0, 90)).save(folder / f"IMG_{i}.JPG", format="JPEG")
    return folder


def test_bare_photographs_are_asked_about_as_a_scene_is(tmp_path):
    folder = photographs(tmp_path / "shed")
    app, plan, found = dropped(folder)
    assert not app.messages.dialogs and plan.problem() is None
    assert found.text.startswith("8 photographs of 1200 × 900. Nothing says where the camera stood")
    assert found.size("quick", None) == (240, 180) and found.size("full", 2) == (600, 450)
    assert plan.stages == ("Poses", "Training", "Baking") and plan.out == tmp_path / "shed-snerg"
    assert plan.typed() == f"snerg-make {folder} --out {plan.out} --preset normal"


def test_bare_panoramas_are_shrunk_by_what_they_show_in_a_quarter_of_a_turn(offscreen, tmp_path, monkeypatch):
    picture = Image.fromarray(photograph(panorama_cameras(1)[0]))
    for file in photographs(tmp_path / "hall").iterdir():
        picture.save(file, format="JPEG")
    app, _, found = dropped(tmp_path / "hall")
    assert found.text.startswith("8 panoramas of 512 × 256. Nothing says where the camera stood")
    assert found.size("quick", None) == (512, 256)
    drawn = drawn_widths(monkeypatch)
    offscreen(app).frames(2)
    assert any("512 pixels" in text and "four times as wide" in text for text in drawn), drawn
    posed = write_transforms(tmp_path / "posed", circle(9), size=(64, 32), lens={}, camera_model="EQUIRECTANGULAR")
    assert dropped(posed)[2].panoramas


@pytest.mark.slow
def test_bare_photographs_are_shown_with_what_is_set_aside_and_the_time_it_takes(offscreen, app, tmp_path):
    ui = offscreen(app)
    write_photographs(tmp_path / "attic")
    (tmp_path / "attic" / "p0b.jpg").write_bytes((tmp_path / "attic" / "p0.jpg").read_bytes())
    app.drop([tmp_path / "attic"])
    until(lambda: ui.frame() or not app.making.busy)
    ui.settle()
    preview = app.making.plan.survey.preview
    assert len(preview.boxes) == COUNT + 1 and preview.aside == {"p0b.jpg": "the same as p0.jpg"}
    assert set(preview.seconds) == {"pictures", "features", "matches", "poses"} and preview.seconds["features"] > 0
    red, green, blue = np.moveaxis(ui.picture().astype(int), -1, 0)
    assert (blue > np.maximum(red, green) + 40).sum() > 300  # of the photographs; nothing else there is blue
    ui.key(imgui.Key.escape)
    assert app.making.plan is None
    until(lambda: preview.finished)


def test_a_film_is_asked_about_and_too_few_photographs_are_refused(tmp_path):
    film = tmp_path / "walk.MOV"
    film.write_bytes(bytes(3_000_000))
    app, plan, found = dropped(film)
    assert found.text.startswith("A film of 3 MB")
    assert plan.out == tmp_path / "walk-snerg" and plan.command()[5] == str(film)
    if found.preview is not None:
        live(app, lambda: not found.busy)
        assert "not a film that can be read" in not_none(plan.problem())
    assert "at least 8, found 2" in not_none(dropped(photographs(tmp_path / "shed", 2))[1].problem())


def test_an_earlier_attempt_is_gone_on_with(scene, tmp_path):
    folder = tmp_path / "lego-snerg"  # as snerg-make leaves it when it is stopped
    (folder / "run" / "checkpoints").mkdir(parents=True)
    (folder / "run" / "config.json").write_text(json.dumps({"scene": str(scene), "config": {"steps": 6000}}))
    (folder / "run" / "checkpoints" / "step_00001000.safetensors").touch()
    app, plan, _ = dropped(folder)
    assert (plan.subject, plan.source, plan.out) == ("scene", scene, folder)
    assert "at step 1,000 of 6,000" in plan.attempt_text() and plan.problem() is None
    app.drop([folder / "run"])
    run = not_none(app.making.plan)
    assert run.subject == "run" and run.out == folder / "pack"
    (folder / "run" / "checkpoints" / "step_00006000.safetensors").touch()
    assert "It is baked" in Plan.of("run", folder).attempt_text()
    other = Plan("scene", tmp_path / "elsewhere", folder)
    assert "another scene" in not_none(other.problem())


@pytest.mark.parametrize("known", [True, False])
def test_found_poses_are_gone_on_with_where_the_folder_of_the_results_is_dropped(tmp_path, known):
    assert (POSED, REPORT) == (find.SCENE, find.REPORT)
    folder = photographs(tmp_path / "shed")
    out = tmp_path / "shed-snerg"
    write_colmap(out / "scene", circle(10), ball())
    (out / "scene" / "poses.json").write_text(json.dumps({"photographs": str(folder if known else tmp_path / "gone")}))
    app, plan, _ = dropped(out)
    assert not app.messages.dialogs and plan.out == out and plan.problem() is None
    assert plan.source == (folder if known else out / "scene") and plan.posed == out / "scene"
    assert ("camera poses in this folder are used" in plan.attempt_text()) == known
    app.drop([out / "scene"])
    assert not_none(app.making.plan).source == out / "scene", "a scene like any other"
    app.making.dismiss()


@pytest.mark.parametrize("place", ["file/pack", "/proc/nope/pack"])
def test_a_folder_that_cannot_be_written_is_told_before_anything_begins(offscreen, app, tmp_path, place):
    (tmp_path / "file").touch()
    ui = offscreen(app, size=(700, 500))
    app.making.plan = Plan("run", tmp_path / "run", tmp_path / place)
    ui.settle()
    ui.key(imgui.Key.enter)
    plan = app.making.plan
    assert app.making.job is None and plan is not None and not app.messages.dialogs
    assert f"{(tmp_path / place).parent} cannot be written" in not_none(plan.place_problem)
    plan.choose(tmp_path / "elsewhere" / "pack")
    assert plan.place_problem is None and not (tmp_path / "elsewhere").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_cut_out_is_on_where_there_is_a_mask_for_each_photograph(tmp_path):
    scene = write_colmap(tmp_path / "shrine", circle(10), ball())
    for picture in (scene / "images").rglob("*.png"):
        mask = scene / "masks" / picture.relative_to(scene / "images")
        mask.parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", Image.open(picture).size, 255).save(mask)
    _, plan, _ = dropped(scene)
    assert plan.masked and plan.cut_out and "--masks" in plan.command()
    plan.masks = False
    assert "--masks" not in plan.command()


@pytest.mark.slow
def test_time_and_disk_are_measured_here_for_each_size_and_preset_of_voxels(tmp_path, monkeypatch):
    monkeypatch.setattr(survey, "MEASURES", True)
    found = Survey(write_procedural_scene(tmp_path / "scene", size=32, views=4, subpixels=1))
    until(lambda: found.finished)
    needed = found.time
    assert needed is not None
    needed.result()  # a busy machine takes longer than other tests wait
    assert found.busy and found.news() and not found.news() and not found.busy
    quick, normal, full = (needed.seconds(preset, 32) or 0.0 for preset in ("quick", "normal", "full"))
    assert 1.0 < quick < normal < 1e6
    ratio = (PRESETS["full"].steps - PRESETS["quick"].steps) / (PRESETS["normal"].steps - PRESETS["quick"].steps)
    assert full - quick == pytest.approx(ratio * (normal - quick))  # their bakes are alike
    assert needed.seconds("paper", 32) is None and needed.disk("paper", 32) is None
    disk = needed.disk("quick", 32)
    assert disk is not None and 1e8 < disk < 1e9
    found.cancel()


@pytest.mark.parametrize(
    ("seconds", "finished", "line"),
    [
        (None, False, "Measuring how long it takes on this computer… It needs up to 2.9 GB"),
        (None, True, "It needs up to 2.9 GB of memory and 0.5 GB on the disk."),
        (437.0, True, "Takes about 7 min as measured on this computer, up to 2.9 GB"),
    ],
)
def test_the_dialog_says_what_is_known(seconds, finished, line):
    known: Any = SimpleNamespace(
        seconds=lambda *_: seconds, disk=lambda *_: 0.51e9, memory=lambda *_: 2.88e9, finished=finished
    )  # fmt: skip
    plan: Any = SimpleNamespace(preset="quick", survey=SimpleNamespace(time=known))
    assert what_it_needs(plan, 200).startswith(line)
    plan.survey.time = None
    assert what_it_needs(plan, 200) == ""
