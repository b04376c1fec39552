"""What test_every_widget.py puts on the screen, by name: every page, dialog and overlay."""

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from console.progress_protocol import Report
from scenepack import Pack
from scenepack.editing import Selection
from scenepack.placement import Placement
from tests.viewer.waiting import not_none
from training.scenes.colmap_files import Reconstruction
from viewer.app.application import App
from viewer.core.annotations import Annotations, Bookmark, Kind, Measurement, Scale
from viewer.core.files import FileRequest
from viewer.core.state import Edits
from viewer.features.crop import crop
from viewer.features.display.display import set_look
from viewer.features.export.exporting import Server, Writing
from viewer.features.making.make_job import MakeJob
from viewer.features.making.make_plan import Plan
from viewer.features.making.review import Review, SparsePreview
from viewer.features.opening.session import Seen, Session
from viewer.features.placing import placing
from viewer.interface.layout import PAGES


@dataclass
class Scenes:
    """What is opened, and what stands in for work of minutes. plan: of photographs that were looked at."""

    pack: Pack
    other: Pack
    path: Path
    photographs: Path
    plan: Plan
    release: threading.Event


def child() -> Any:
    """A process that works on and on."""
    report = Report("training", 2400, 6000, "PSNR 26.80 dB", 180.0, "training", seconds_left=270.0)
    child = SimpleNamespace(
        stopping=False, killed=False, poll=lambda: None, report=report, warnings=lambda: [],
        log=Path(os.devnull),
    )  # fmt: skip
    child.stop = lambda: setattr(child, "stopping", True)
    child.kill = lambda: setattr(child, "killed", True)
    child.end = lambda seconds: None
    return child


KINDS: dict[Kind, int] = {"line": 3, "angle": 3, "point": 1}  # and points of each
Prepare = Callable[[App, Scenes], object]


def _start(app: App, scenes: Scenes) -> None:
    app.demo = scenes.path
    app.sessions.last = Session((Seen(scenes.path, Bookmark("toy", (0.0, 0.0, 3.0), (0.0, 0.0, 0.0))),))
    app.preferences.recent = [str(scenes.path), str(scenes.photographs)]


def _page(page: str, *more: Prepare) -> Prepare:
    def prepare(app: App, scenes: Scenes) -> None:
        app.interface.page = page
        for each in more:
            each(app, scenes)

    return prepare


def _film(app: App, scenes: Scenes) -> None:
    app.filming.size, app.filming.fps = (64, 48), 60.0
    app.filming.turntable(app)
    app.filming.select(app, 1)
    app.filming.path.keyframes = [replace(key, seconds=10.0) for key in app.filming.path.keyframes]


def _job(app: App, scenes: Scenes) -> None:
    job = app.making.job = MakeJob(scenes.plan, child())
    job.figures = [20.0, 22.0, 23.0]
    job.picture = np.full((64, 128, 3), 99, np.uint8)


def _review(app: App, scenes: Scenes) -> None:
    pack = scenes.pack
    low, high = crop.whole(pack)
    boxes: Any = {"subject": np.array([low, high]), "room": np.array([low, high])}
    scene: Any = SimpleNamespace(splits={"train": range(4)}, aabb=boxes["subject"])
    points = Reconstruction((), (), np.zeros((99, 3)), np.zeros((99, 3), np.uint8), np.ones(99), ())
    app.making.sparse_preview = SparsePreview(pack, scene, points, "forward", boxes)
    app.making.review = Review(scenes.plan, app.making.sparse_preview)
    app.making.review.hold()
    app.making.choose_kind(app, "room")


def _plan(subject: str, attempt: dict | None = None) -> Prepare:
    def prepare(app: App, scenes: Scenes) -> None:
        if subject == "run":
            app.making.plan = Plan("run", scenes.path.parent / "run", scenes.path.parent / "baked")
        else:
            app.making.plan = scenes.plan
        scenes.plan.attempt = attempt

    return prepare


def _checked(app: App, scenes: Scenes) -> None:
    _checking(app, scenes)
    assert app.making.check is not None
    app.making.check.close()
    app.making.check.result = {
        "expected_psnr": 27.0, "kind": "seen from one side", "sharpness": 1.0, "overlap": 0.9, "exposure_spread": 0.1,
        "photographs": [{}] * 20, "set_aside": {"a.jpg": "blurred"}, "weakly_connected": {}, "differently_exposed": {},
    }  # fmt: skip


def _checking(app: App, scenes: Scenes) -> None:
    _plan("scene")(app, scenes)
    app.making.check_photographs(app)


def _compare(app: App, scenes: Scenes) -> None:
    app.comparison.with_pack(app, scenes.other, scenes.path)
    app.comparison.how = "difference"


def _stand_in(app: App, scenes: Scenes) -> None:
    app.gallery.stand_in(app, 1)
    app.comparison.how = "difference"


def _near(app: App, scenes: Scenes) -> None:
    app.set(near=0.3)


def _crop(app: App, scenes: Scenes) -> None:
    app.set(crop=crop.placed(app.open_scene.pack, np.zeros(3), np.full(3, 1.2)))


def _measured(app: App, scenes: Scenes) -> None:
    points = ((0.0, 0.1, 0.3), (0.3, 0.1, 0.0), (0.0, -0.5, 0.3))
    measurements = tuple(Measurement(kind, points[:count]) for kind, count in KINDS.items())
    app.annotations.current = Annotations(Scale(2.0, "m"), measurements)
    app.measure_tool.selected = 0


def _scaling(app: App, scenes: Scenes) -> None:
    app.measure_tool.tool, app.measure_tool.draft = "scale", ((0.0, 0.1, 0.3), (0.3, 0.1, 0.0))


def _bookmarked(app: App, scenes: Scenes) -> None:
    for name, command in (
        ("toy from before, with a name that is longer than the list", "front"),
        ("toy from above", "top"),
    ):
        app.run(command)
        app.open_scene.rig.shown = app.open_scene.rig.goal
        app.run("bookmark")
        app.bookmarks.edit(app, not_none(app.bookmarks.selected), name=name)


def _erased(app: App, scenes: Scenes) -> None:
    one = Selection({0: np.eye(1, app.open_scene.pack.block_size**3 // 8, dtype=np.uint8)[0]})
    app.open_scene.edits, app.erasing.tool = Edits(one, one), "brush"


def _ask_for(kind: Literal["open", "save"]) -> Prepare:
    return lambda app, scenes: setattr(app, "file_request", FileRequest("Save the path", kind, lambda path: None))


BUTTONS = (("Keep going", ""), ("Stop and quit", "stop-and-quit"))
PLACES: dict[str, Prepare] = {
    "start": _start,
    "scene": _page(""),
    **{page.id: _page(page.id) for page in PAGES},
    "view, costs": _page("view", lambda app, _: app.set(mode="samples")),
    "view, colours changed": _page("view", lambda app, _: set_look(app, exposure=0.5)),
    "camera, flying": _page("camera", _near, lambda app, _: app.open_scene.rig.navigate("fly")),
    "camera, walking": _page("camera", _near, lambda app, _: app.run("walk")),
    "crop, a box": _page("crop", _near, _crop),
    "erase, something of it": _page("erase", _near, _crop, _erased),
    "erase, the lasso": _page("erase", lambda app, _: setattr(app.erasing, "tool", "lasso")),
    "bookmarks, two of them": _page("bookmarks", _bookmarked),
    "measure, three of them": _page("measure", _measured),
    "measure, a known length": _page("measure", _scaling),
    "move, another origin": _page("move", lambda app, _: placing.put(app, Placement(origin=(0.0, -0.5, 0.0)))),
    "photographs, frusta": _page("photographs", lambda app, _: setattr(app.gallery, "frusta", True)),
    "photographs, one of them": _page("photographs", _stand_in),
    "compare, two packs": _page("compare", _compare),
    "film, a path": _page("film", _film),
    "film, an export": _page("film", _film, lambda app, scenes: app.filming.film(app, scenes.path.parent / "film")),
    "film, a lens": _page("film", lambda app, _: setattr(app.filming, "aperture", 0.1)),
    "keys": lambda app, _: app.run("help"),
    "open": lambda app, _: app.run("open"),
    "a page that floats": lambda app, _: app.interface.moved.append("camera"),
    "opening": lambda app, scenes: app.open(scenes.path),
    "export the scene": _page("film", _near, _crop, lambda app, _: app.exporting.ask(app)),
    "export points": lambda app, _: (setattr(app.exporting.plan, "kind", "points"), app.exporting.ask(app)),
    "export a page": lambda app, _: (setattr(app.exporting.plan, "kind", "page"), app.exporting.ask(app)),
    "a scene that is shared": lambda app, scenes: setattr(
        app.sharing,
        "server",
        Server(child(), scenes.path.parent / "no such folder", name="toy", address="http://127.0.0.1:9/x/"),
    ),
    "a scene that is being exported": lambda app, scenes: setattr(
        app.exporting,
        "writing",
        Writing(child(), scenes.path.parent / "no such folder", file=scenes.path.parent / "mesh.glb"),
    ),
    "making": _job,
    "making, from the start page": lambda app, scenes: (_start(app, scenes), _job(app, scenes)),
    "review": _review,
    "failure": lambda app, _: app.messages.fail("It cannot be opened", "the file is no pack " * 9),
    "question": lambda app, _: app.messages.fail("toy is still being made", "Quitting stops it.", buttons=BUTTONS),
    "path to open": _ask_for("open"),
    "path to save": _ask_for("save"),
    "make a scene": _plan("scene"),
    "make it again": _plan("scene", attempt={"scene": "", "steps": 6000}),
    "photographs that are checked": _checking,
    "photographs that were checked": _checked,
    "bake a run": _plan("run"),
}
WITHOUT_SCENE = ("start", "making, from the start page")
