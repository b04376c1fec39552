"""What is asked before a scene is made: what is there, what can be chosen, where it goes, which command it becomes."""

import functools
import json
import sys
from pathlib import Path
from typing import get_args

import pytest
from imgui_bundle import imgui
from PIL import Image

from console.progress_protocol import Report
from tests.training.reconstructions import around, ball, write_colmap
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.waiting import until
from training.posing import find
from training.scenes.presets import BakeablePreset
from viewer.app.application import App
from viewer.core.files import POSED, REPORT
from viewer.features.making import survey
from viewer.features.making.make_job import MakeJob
from viewer.features.making.make_plan import Plan


def test_a_scene_that_is_dropped_is_asked_about(scene, tmp_path):
    app = App(canvas=FakeCanvas())
    app.drop([scene])
    plan = app.making.plan
    assert plan.subject == "scene" and plan.out == scene.parent / "still-snerg"
    until(lambda: plan.survey.finished)
    assert plan.survey.text.startswith("5 photographs of 24 × 24") and "Blender" in plan.survey.text
    assert plan.problem() is None
    plan.downscale, plan.preset = 2, "full"
    assert plan.survey.size("full", 2) == (12, 12)
    app.making.copy_command(app)
    assert app.clipboard.get() == f"snerg-make {scene} --out {plan.out} --preset full --downscale 2"
    assert "--no-view" in plan.command()
    app.making.dismiss(app)
    assert app.making.plan is None and not app.messages.dialogs


@pytest.mark.parametrize("folder", ["sparse/0", "sparse"])
def test_a_reconstruction_of_colmap_is_a_scene(tmp_path, folder):
    app = App(canvas=FakeCanvas())
    app.drop([write_colmap(tmp_path / "shrine", around(), ball(), folder=folder)])
    survey = app.making.plan.survey
    until(lambda: survey.finished)
    assert survey.text == "10 photographs of 48 × 36, 360°  (COLMAP)" and app.making.plan.problem() is None


def test_the_commands_are_ones_that_the_real_programs_take(scene, tmp_path, monkeypatch):
    from baker.commands import bake, make

    made = Plan("scene", scene, tmp_path, "full", downscale=2, spherify=True, masks=True, steps=5, resolution=96)
    for plan, module, name in ((made, make, "snerg_make"), (Plan("run", scene, tmp_path / "p"), bake, "snerg_bake")):
        assert plan.command()[:4] == [sys.executable, "-P", "-m", module.__name__]
        called = {}
        real = getattr(module, name)
        stand_in = functools.wraps(real)(lambda *words, **options: called.update(options))  # noqa: B023
        monkeypatch.setattr(module, name, stand_in)
        assert module.main(plan.command()[4:]) == 0
        assert called["out"] == plan.out
        if plan.subject == "scene":
            assert called["no_view"] and called["masks"] and called["spherify"] and called["preset"] == "full"
            assert (called["downscale"], called["steps"], called["resolution"]) == (2, 5, 96)
    monkeypatch.undo()
    assert set(survey.OFFERED) <= set(get_args(BakeablePreset))


def test_a_broken_scene_is_told_before_anything_is_begun(tmp_path):
    (tmp_path / "transforms_train.json").write_text('{"frames": []}')
    app = App(canvas=FakeCanvas())
    app.drop([tmp_path])
    until(lambda: app.making.plan.survey.finished)
    assert str(tmp_path) in app.making.plan.problem()
    app.making.start(app)
    assert app.making.job is None and app.making.plan is not None


def test_the_viewer_alone_says_what_is_missing(scene, monkeypatch, tmp_path):
    monkeypatch.setattr(survey.importlib.util, "find_spec", lambda name: None)
    assert "pip install 'snerg[train]'" in Plan("scene", scene, tmp_path).problem()


def photographs(folder: Path, count: int = 8) -> Path:
    """A folder of pictures, and nothing that says where the camera stood."""
    folder.mkdir()
    for i in range(count):
        Image.new("RGB", (1200, 900), (25 * i, 0, 90)).save(folder / f"IMG_{i}.JPG", format="JPEG")
    return folder


def test_bare_photographs_are_asked_about_as_a_scene_is(tmp_path):
    folder = photographs(tmp_path / "shed")
    app = App(canvas=FakeCanvas())
    app.drop([folder])
    plan = app.making.plan
    until(lambda: plan.survey.finished)
    assert not app.messages.dialogs and plan.problem() is None
    assert plan.survey.text.startswith("8 photographs of 1200 × 900. Nothing says where the camera stood")
    assert plan.survey.size("quick", None) == (240, 180) and plan.survey.size("full", 2) == (600, 450)
    assert plan.stages == ("Poses", "Training", "Baking") and plan.out == tmp_path / "shed-snerg"
    assert plan.typed() == f"snerg-make {folder} --out {plan.out} --preset normal"


def test_what_lies_beside_photographs_or_a_film_and_is_not_used_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(survey, "poser_missing", lambda source: "poses")  # no preview
    folder = photographs(tmp_path / "shed")
    (folder / "a.gif").write_bytes(b"")
    (tmp_path / "walk").mkdir()
    (tmp_path / "gif").mkdir()
    for file in ("walk/walk.MTS", "walk/cover.jpg", "walk/._walk.MTS", "gif/a.gif"):
        (tmp_path / file).write_bytes(b"")
    app = App(canvas=FakeCanvas())
    for path, told in (
        (folder, "1 GIF picture, a format that is not read"),
        (tmp_path / "walk", "not cover.jpg beside it."),
    ):
        app.drop([path])
        until(lambda: app.making.plan.survey.finished)
        assert told in app.making.plan.survey.text
    app.drop([tmp_path / "gif"])
    until(lambda: app.making.plan.survey.finished)
    assert "found 1 GIF picture" in app.making.plan.problem()


def test_photographs_of_which_too_few_can_be_used_and_masks_beside_them_are_told(tmp_path):
    pytest.importorskip("pycolmap", reason="finding poses needs pycolmap (the extra poses)")
    folder = photographs(tmp_path / "shed")
    Image.new("RGB", (1200, 900), (175, 0, 90)).save(folder / "IMG_9.JPG", format="JPEG")
    (folder / "IMG_0.JPG").unlink()
    app = App(canvas=FakeCanvas())
    app.drop([folder])
    plan = app.making.plan
    until(lambda: not plan.survey.busy)
    assert plan.survey.preview.aside == {"IMG_9.JPG": "the same as IMG_7.JPG"}
    assert plan.problem() == "Only 7 of 8 photographs can be used. Finding camera poses takes at least 8."
    assert not plan.survey.masks
    (folder / "masks").mkdir()
    for file in folder.glob("*.JPG"):
        Image.new("L", (1200, 900), 255).save(folder / "masks" / f"{file.name}.png")
    app.drop([folder])
    until(lambda: app.making.plan.survey.finished)
    assert app.making.plan.cut_out and "--masks" in app.making.plan.command()
    app.making.dismiss(app)
    until(lambda: plan.survey.preview.finished)


def test_a_run_whose_poses_were_found_is_gone_on_with(tmp_path):
    folder = photographs(tmp_path / "shed")
    out = tmp_path / "shed-snerg"
    (out / "posing").mkdir(parents=True)
    assert "It continues" in Plan.of("scene", folder).attempt_text()
    unfinished(out, out / "scene")
    plan = Plan.of("scene", folder)
    assert plan.attempt is not None and plan.problem() is None


@pytest.mark.parametrize(("stage", "title", "number"), [
    ("poses", "features", 1), ("poses", "matches", 1), ("training", "training", 2), ("baking", "culling", 3),
])  # fmt: skip
def test_the_card_says_that_poses_come_before_training(stage, title, number, tmp_path):
    job = MakeJob(Plan.of("scene", photographs(tmp_path / "shed")), None)
    job.report = Report(title, 1, 2, stage=stage)
    assert job.stage == number and job.plan.stages[number - 1].lower() == stage


def test_a_film_is_asked_about_and_too_few_photographs_are_refused(tmp_path):
    film = tmp_path / "walk.MOV"
    film.write_bytes(bytes(3_000_000))
    app = App(canvas=FakeCanvas())
    app.drop([film])
    plan = app.making.plan
    until(lambda: plan.survey.finished)
    assert plan.survey.text.startswith("A film of 3 MB")
    assert plan.out == tmp_path / "walk-snerg" and plan.command()[4] == str(film)
    if plan.survey.preview is not None:
        until(lambda: not plan.survey.busy)
        assert "not a film that can be read" in plan.problem()
    app.drop([photographs(tmp_path / "shed", 2)])
    until(lambda: app.making.plan.survey.finished)
    assert "at least 8, found 2" in app.making.plan.problem()


def test_without_pycolmap_bare_photographs_say_what_is_missing(tmp_path, monkeypatch):
    plan = Plan.of("scene", photographs(tmp_path / "shed"))
    film = tmp_path / "walk.mp4"
    film.touch()
    until(lambda: plan.survey.finished)
    there = survey.importlib.util.find_spec
    monkeypatch.setattr(
        survey.importlib.util, "find_spec", lambda name: None if name in ("pycolmap", "av") else there(name)
    )
    assert "pip install 'snerg[poses]'" in plan.problem()
    assert "pip install 'snerg[poses,video]'" in Plan.of("scene", film).problem()


def unfinished(folder: Path, scene: Path) -> Path:
    """What snerg-make leaves when it is stopped."""
    (folder / "run" / "checkpoints").mkdir(parents=True)
    (folder / "run" / "config.json").write_text(json.dumps({"scene": str(scene), "config": {"steps": 6000}}))
    (folder / "run" / "checkpoints" / "step_00001000.safetensors").touch()
    return folder


def test_an_earlier_attempt_is_gone_on_with(scene, tmp_path):
    folder = unfinished(tmp_path / "lego-snerg", scene)
    app = App(canvas=FakeCanvas())
    app.drop([folder])
    plan = app.making.plan
    assert (plan.subject, plan.source, plan.out) == ("scene", scene, folder)
    assert "at step 1,000 of 6,000" in plan.attempt_text() and plan.problem() is None
    app.drop([folder / "run"])
    assert app.making.plan.subject == "run" and app.making.plan.out == folder / "pack"
    (folder / "run" / "checkpoints" / "step_00006000.safetensors").touch()
    assert "It is baked" in Plan.of("run", folder).attempt_text()
    other = Plan("scene", tmp_path / "elsewhere", folder)
    assert "another scene" in other.problem()


@pytest.mark.parametrize("there", [True, False])
def test_found_poses_are_gone_on_with_where_the_folder_of_the_results_is_dropped(tmp_path, there):
    assert (POSED, REPORT) == (find.SCENE, find.REPORT)
    folder = photographs(tmp_path / "shed")
    out = tmp_path / "shed-snerg"
    write_colmap(out / "scene", around(), ball())
    (out / "scene" / "poses.json").write_text(json.dumps({"photographs": str(folder if there else tmp_path / "gone")}))
    app = App(canvas=FakeCanvas())
    app.drop([out])
    plan = app.making.plan
    until(lambda: plan.survey.finished)
    assert not app.messages.dialogs and plan.out == out and plan.problem() is None
    assert plan.source == (folder if there else out / "scene") and plan.posed == out / "scene"
    assert plan.has_points and ("camera poses in this folder are used" in plan.attempt_text()) == there
    app.drop([out / "scene"])
    assert app.making.plan.source == out / "scene", "a scene like any other"
    app.making.dismiss(app)


@pytest.mark.parametrize("text", ["{}", '{"scene": 3, "config": 4}', '{"scene": "", "config": {}}', "[1]", "{"])
def test_an_attempt_whose_description_is_broken_is_told_or_baked(tmp_path, text):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "config.json").write_text(text)
    app = App(canvas=FakeCanvas())
    app.drop([tmp_path])
    told = bool(app.messages.dialogs) and "config.json" in app.messages.dialogs[0].text
    assert told != (app.making.plan is not None and app.making.plan.source == tmp_path / "run")


@pytest.mark.parametrize("place", ["file/pack", "/proc/nope/pack"])
def test_a_folder_that_cannot_be_written_is_told_before_anything_begins(offscreen, app, tmp_path, place):
    (tmp_path / "file").touch()
    ui = offscreen(app, size=(700, 500))
    app.making.plan = Plan("run", tmp_path / "run", tmp_path / place)
    ui.settle()
    ui.key(imgui.Key.enter)
    plan = app.making.plan
    assert app.making.job is None and plan is not None and not app.messages.dialogs
    assert f"{(tmp_path / place).parent} cannot be written" in plan.place_problem
    plan.choose(tmp_path / "elsewhere" / "pack")
    assert plan.place_problem is None and not (tmp_path / "elsewhere").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_change_begins_at_the_folder_of_now(offscreen, app, tmp_path):
    (tmp_path / "something").touch()
    app.making.plan = Plan("run", tmp_path / "run", tmp_path / "not there yet" / "pack")
    app.making.ask_where(app)
    assert app.file_request.start == tmp_path
    ui = offscreen(app)
    ui.settle()
    ui.key(imgui.Key.enter)  # the line that is there, as it is
    assert app.file_request is None and app.making.plan.out == tmp_path / "pack"


@pytest.fixture
def masked(tmp_path) -> Path:
    """A capture with a mask for each photograph."""
    scene = write_colmap(tmp_path / "shrine", around(), ball())
    (scene / "masks").mkdir()
    for picture in (scene / "images").rglob("*.png"):
        mask = scene / "masks" / picture.relative_to(scene / "images")
        mask.parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", Image.open(picture).size, 255).save(mask)
    return scene


def surveyed(path: Path) -> Plan:
    app = App(canvas=FakeCanvas())
    app.drop([path])
    until(lambda: app.making.plan.survey.finished)
    return app.making.plan


def test_cut_out_is_on_where_there_is_a_mask_for_each_photograph(masked):
    plan = surveyed(masked)
    assert plan.masked and plan.cut_out and "--masks" in plan.command()
    plan.masks = False
    assert "--masks" not in plan.command()


def test_cut_out_is_not_offered_where_a_mask_is_missing(masked):
    next((masked / "masks").rglob("*.png")).unlink()
    plan = surveyed(masked)
    assert plan.survey.masks and not plan.masked and not plan.cut_out and "--masks" not in plan.command()


def test_a_folder_of_pictures_inside_a_scene_leads_to_the_scene(masked, scene):
    assert surveyed(masked / "images").source == masked
    assert surveyed(masked / "images" / "left").source == masked
    assert surveyed(scene / "train").source == scene
