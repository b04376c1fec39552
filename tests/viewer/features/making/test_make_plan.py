"""What is asked before a scene is made: what is there, what can be chosen, where it goes, which command it becomes."""

from __future__ import annotations

import functools
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image

from tests.training.posing.conftest import COUNT, write_photographs
from tests.training.reconstructions import ball, write_colmap
from tests.training.test_captures import circle
from tests.viewer.app.test_application import FakeCanvas
from tests.viewer.waiting import live, there, until
from tools.procedural import write_procedural_scene
from training.config import PRESETS
from training.posing import find
from training.scenes.presets import BakeablePreset
from viewer.app.application import App
from viewer.core.files import POSED, REPORT
from viewer.features.making import survey
from viewer.features.making.make_plan import Plan
from viewer.features.making.panel import what_it_needs
from viewer.features.making.survey import Survey


def dropped(path: Path) -> tuple[App, Plan, Survey]:
    """An app whose dialog asks about `path`; how it would be made; the survey of its photographs, which is finished."""
    app = App(canvas=FakeCanvas())
    app.drop([path])
    plan = there(app.making.plan)
    survey = there(plan.survey)
    until(lambda: survey.finished)
    return app, plan, survey


def test_a_scene_that_is_dropped_is_asked_about(scene, tmp_path):
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
    app, plan, _ = dropped(tmp_path)
    assert str(tmp_path) in there(plan.problem())
    app.making.start(app)
    assert app.making.job is None and app.making.plan is not None


def test_the_viewer_alone_says_what_is_missing(scene, monkeypatch, tmp_path):
    monkeypatch.setattr(survey.importlib.util, "find_spec", lambda name: None)
    assert "pip install 'snerg[train]'" in there(Plan("scene", scene, tmp_path).problem())


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
    assert plan.out == tmp_path / "walk-snerg" and plan.command()[4] == str(film)
    if found.preview is not None:
        live(app, lambda: not found.busy)
        assert "not a film that can be read" in there(plan.problem())
    assert "at least 8, found 2" in there(dropped(photographs(tmp_path / "shed", 2))[1].problem())


def test_an_earlier_attempt_is_gone_on_with(scene, tmp_path):
    folder = tmp_path / "lego-snerg"  # as snerg-make leaves it when it is stopped
    (folder / "run" / "checkpoints").mkdir(parents=True)
    (folder / "run" / "config.json").write_text(json.dumps({"scene": str(scene), "config": {"steps": 6000}}))
    (folder / "run" / "checkpoints" / "step_00001000.safetensors").touch()
    app = App(canvas=FakeCanvas())
    app.drop([folder])
    plan = there(app.making.plan)
    assert (plan.subject, plan.source, plan.out) == ("scene", scene, folder)
    assert "at step 1,000 of 6,000" in plan.attempt_text() and plan.problem() is None
    app.drop([folder / "run"])
    run = there(app.making.plan)
    assert run.subject == "run" and run.out == folder / "pack"
    (folder / "run" / "checkpoints" / "step_00006000.safetensors").touch()
    assert "It is baked" in Plan.of("run", folder).attempt_text()
    other = Plan("scene", tmp_path / "elsewhere", folder)
    assert "another scene" in there(other.problem())


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
    assert there(app.making.plan).source == out / "scene", "a scene like any other"
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
    assert f"{(tmp_path / place).parent} cannot be written" in there(plan.place_problem)
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


# What making a scene takes on this computer: measured by the real program, told in the dialog, given up with it


@pytest.mark.slow
def test_time_and_disk_are_measured_here_for_each_size_and_preset_of_voxels(tmp_path, monkeypatch):
    monkeypatch.setattr(survey, "MEASURES", True)
    found = Survey(write_procedural_scene(tmp_path / "scene", size=32, views=4, subpixels=1))
    until(lambda: found.finished)
    needed = found.time
    assert needed is not None
    needed.result()  # a busy machine takes longer than other tests wait
    assert found.busy and found.news() and not found.news() and not found.busy
    seconds = needed.seconds("quick", 32)
    assert seconds is not None and 1.0 < seconds < 1e6
    assert needed.seconds("full", 32) == pytest.approx(PRESETS["full"].steps / PRESETS["quick"].steps * seconds)
    assert needed.seconds("paper", 32) is None and needed.disk("paper", 32) is None
    disk = needed.disk("quick", 32)
    assert disk is not None and 1e8 < disk < 1e9
    found.close()


@pytest.mark.parametrize(
    ("seconds", "finished", "line"),
    [
        (None, False, "Measuring how long it takes on this computer… It needs up to 2.9 GB"),
        (None, True, "It needs up to 2.9 GB of memory and 0.5 GB on the disk."),
        (437.0, True, "Takes about 7 min as measured on this computer, up to 2.9 GB"),
    ],
)
def test_the_dialog_says_what_is_known(seconds, finished, line):
    known: Any = SimpleNamespace(seconds=lambda *_: seconds, disk=lambda *_: 0.51e9, finished=finished)
    plan: Any = SimpleNamespace(preset="quick", survey=SimpleNamespace(time=known))
    assert what_it_needs(plan, 200).startswith(line)
    plan.survey.time = None
    assert what_it_needs(plan, 200) == ""
