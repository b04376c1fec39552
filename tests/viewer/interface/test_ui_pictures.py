"""Pictures of every page, dialog and overlay, drawn offscreen and compared with those in tests/golden/ui.

What differs from run to run (times, paths, frame rates) is set by hand before a picture is taken.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.viewer.conftest import toy_pack
from tests.viewer.interface.places import child
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.rendering.pictures import compare_with_golden, flip
from tests.viewer.waiting import at_once, not_none, until
from tools.procedural import write_procedural_scene
from viewer.core.annotations import Annotations, Measurement, Scale
from viewer.core.log import LogLine
from viewer.core.theme import THEMES
from viewer.features.crop import crop
from viewer.features.making import make_plan
from viewer.features.making.make_job import MakeJob
from viewer.features.making.make_plan import Plan
from viewer.features.making.survey import Survey
from viewer.features.performance.frame_stats import FrameStats
from viewer.interface.layout import PAGES

SIZE = (900, 640)
USUAL = ((800, 600), (1280, 800))
WHOLE = [*((size, 1.0, theme) for size in USUAL for theme in THEMES), ((1920, 1080), 2.0, "dark")]
FLIP_TOLERANCE = 0.01  # mean over the picture: a moved label gives 0.02 and more, another driver's rounding 0.003
FADING_FRAMES = 15  # what lies behind a dialog dims within a sixth of a second
Picture = Callable[[OffscreenUi, str], None]


@pytest.fixture
def window(scenes, offscreen, app) -> Callable[..., OffscreenUi]:
    """Makes a window with the toy, at the size and the density that are given."""

    def make(size: tuple[int, int] = SIZE, density: float = 1.0, name: str = "toy") -> OffscreenUi:
        ui = offscreen(app, size=size, density=density)
        app.resolution.rest_scale = 0.5 / density  # the scene's own pictures are compared elsewhere
        app.show(scenes.pack, Path("scenes/toy"), name)
        return ui

    return make


@pytest.fixture
def ui(window) -> OffscreenUi:
    return window()


@pytest.fixture
def compare(request) -> Picture:
    """Takes the picture of an interface, all of it or one page, and compares it with the golden one."""

    def take(ui: OffscreenUi, name: str, columns: slice = slice(None)) -> None:
        renderer = ui.ctx.info["GL_RENDERER"]
        ui.settle()
        ui.frames(FADING_FRAMES)
        _freeze(ui)
        ui.frames(2)
        picture = ui.picture()
        if ui.density != 1:  # a pixel for each unit
            picture = np.asarray(Image.fromarray(picture).reduce(round(ui.density)))
        compare_with_golden(request.config, renderer, f"ui/{name}", picture[:, columns], _differs)

    return take


def _differs(picture: np.ndarray, expected: np.ndarray) -> str:
    mean = flip(picture, expected)
    return f"FLIP {mean:.4f}, allowed {FLIP_TOLERANCE}" if mean > FLIP_TOLERANCE else ""


def _freeze(ui: OffscreenUi) -> None:
    app = ui.app
    app.times = FrameStats()
    for i in range(120):
        app.times.add(17.0 + 6 * np.sin(i / 9) + 20 * (i % 40 == 7), 9.0 + 3 * np.sin(i / 5), None)
    ui.canvas.picture_ms = 41.5
    ui.canvas.ctx.info["GL_RENDERER"] = "llvmpipe"
    app.messages.lines.clear()
    noon = time.mktime((2026, 1, 1, 12, 0, 0, 0, 1, -1))
    app.messages.lines.append(LogLine("info", "toy is open, from scenes/toy", noon))
    app.messages.lines.append(LogLine("warning", "the view MLP is all zero; the pack is shown as diffuse", noon + 2))
    photographs, thumbnails = app.gallery.photographs, app.gallery.thumbnails
    if photographs is not None:
        photographs.folder = Path("scenes/toy")
        if thumbnails is not None:
            thumbnails.folder = photographs.folder


TURN = ((0.5, 0.4, 0.08), (0.4, -0.1, 0.1), (0.0, -0.1, 0.4))
ON_THE_PLATE = ((-0.6, -0.64, 0.2), (0.0, -0.64, 0.6), (0.6, -0.64, 0.2))
WINDOWS = ("photograph", "frusta", "crop-gizmo", "measure", "help", "dialog", "path", "light", "legend-depth",
           "legend-samples")  # fmt: skip
SIDE = slice(SIZE[0] - 372, None)


@pytest.mark.parametrize("page", [page.id for page in PAGES])
def test_each_page_looks_as_before(ui, app, compare, page):
    app.interface.page = page
    if page == "crop":
        app.crop_tool = "scale"
        app.set(crop=crop.placed(app.scene.pack, np.zeros(3), np.full(3, 1.2)))
    elif page == "bookmarks":
        for command in ("front", "right"):
            app.run(command)
            app.scene.rig.shown = app.scene.rig.goal
            app.run("bookmark")
    elif page == "measure":
        points = ((0.0, 0.1, 0.3), (0.3, 0.1, 0.0), (0.0, -0.5, 0.3))
        measurements = Measurement("line", points), Measurement("point", points[:1])
        app.annotations.current = Annotations(Scale(2.0, "m"), measurements)
    elif page == "photographs":
        app.gallery.frusta = True
    elif page == "compare":
        app.comparison.with_pack(app, toy_pack(view_mlp=False), Path("toy-diffuse"))
    elif page == "film":
        app.run("turntable")
    elif page == "performance":
        app.costs.switch(True)
    compare(ui, f"page-{page}", SIDE)


def test_the_start_page_looks_as_before(offscreen, app, compare, monkeypatch):
    monkeypatch.setattr(type(app.preferences), "recent_packs", lambda _: [Path("/scenes/lego"), Path("/scenes/fern")])
    app.demo = Path("demo.zip")
    compare(offscreen(app, size=SIZE), "start")


@pytest.mark.parametrize("name", WINDOWS)
def test_the_window_looks_as_before(ui, app, compare, name):
    if name == "photograph":
        app.interface.page = "photographs"
        app.gallery.stand_in(app, 1)
    elif name == "frusta":
        app.interface.page, app.gallery.frusta = "", True
        at_once(app.scene.rig.dolly, -9)
    elif name == "crop-gizmo":
        app.interface.page, app.crop_tool = "crop", "move"
        app.set(crop=crop.placed(app.scene.pack, np.zeros(3), np.full(3, 1.2)))
    elif name == "measure":  # light and dark behind the lines, and a point that is about to be placed
        app.interface.page = "measure"
        lines = (Measurement("line", ON_THE_PLATE), Measurement("angle", TURN))
        app.annotations.current = Annotations(measurements=lines)
        app.measure_tool.tool, app.measure_tool.selected = "line", 1
        app.measure_tool.draft = ((-1.2, 0.6, 0.0), (-0.4, 0.6, 0.0))
    elif name == "light":
        app.set_theme("light")
        app.set_backdrop("gradient")
        app.interface.page = "settings"
    elif name == "dialog":
        app.messages.fail("lego cannot be opened", "scene_params.json: is not JSON (expected an object, found 'x')")
    elif name.startswith("legend"):
        app.set(mode=name.removeprefix("legend-"))
    else:
        app.run({"help": "help", "path": "open"}[name])
    compare(ui, name)


@pytest.mark.parametrize("what", ["bar", "page", "keys"])
def test_the_smallest_window_looks_as_before(window, app, compare, what):
    ui = window((480, 360), name="A scene whose name is too long")
    app.interface.over = "camera" if what == "page" else ""
    app.interface.help_shown = what == "keys"
    compare(ui, f"small-{what}")


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    return write_procedural_scene(tmp_path_factory.mktemp("photographs") / "still", size=64, views=4, subpixels=1)


def plan_of(scene: Path) -> Plan:
    """How the scene would be made, with folders that are the same everywhere."""
    plan = Plan("scene", scene, Path("/scenes/still-snerg"), survey=Survey(scene))
    until(lambda: not_none(plan.survey).finished)
    return plan


@pytest.mark.parametrize("which", ["scene", "again", "run", "refused"])
def test_the_questions_how_to_make_a_scene_look_as_before(ui, app, compare, photographs, which, monkeypatch):
    monkeypatch.setattr(make_plan, "why_not_writable", lambda folder: None)  # /scenes, which not everybody may make
    plan = plan_of(photographs)
    if which == "again":
        plan.attempt = {"scene": str(photographs), "steps": 6000}
    elif which == "run":
        plan = Plan("run", Path("/scenes/still-snerg/run"), Path("/scenes/still-snerg/pack"))
    elif which == "refused":
        plan.attempt = {"scene": "/scenes/lego", "steps": 6000}
    app.making.plan = plan
    compare(ui, f"make-{which}")


def test_the_question_what_to_export_looks_as_before_with_a_preview_that_turns(ui, app, compare, scenes):
    app.show(scenes.pack, scenes.path, "toy")
    app.exporting.ask(app)
    compare(ui, "export")
    goal = app.scene.rig.goal
    ui.drag([(730, 300), (770, 310), (800, 320)])
    ui.settle()
    assert app.scene.rig.goal.azimuth != goal.azimuth and app.exporting.preview is not None
    app.exporting.dismiss()
    ui.frame()


def test_a_scene_being_made_looks_as_before(ui, app, compare, photographs):
    job = app.making.job = MakeJob(plan_of(photographs), child())
    job.figures = [float(21 + 6 * (1 - np.exp(-i / 8)) + 0.3 * np.sin(3 * i)) for i in range(30)]
    with Image.open(photographs / "test" / "r_0.png") as opened:
        shown = np.asarray(opened.convert("RGB").resize((256, 256)))
    job.picture = np.concatenate([shown, shown // 2 + 64], axis=1)
    compare(ui, "make-job")


@pytest.mark.parametrize(("size", "density", "theme"), WHOLE)
def test_whole_windows_look_as_before(window, app, compare, size, density, theme):
    """size: in units, of `density` pixels. A dense screen's picture is compared at half its pixels."""
    ui = window(size, density)
    app.set_theme(theme)
    app.interface.opens("view")
    compare(ui, f"whole-{size[0]}x{size[1]}-{theme}")
