"""The export of the scene as a feature of the viewer: what it asks of the command, and what it says when that fails."""

import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest

from baker.commands import pack as command
from console import UserError
from scenepack import Pack
from scenepack.exports import scene
from scenepack.exports.scene import Export
from tests.stand_ins import raising
from tests.viewer.waiting import not_none, until
from tests.viewer.web.test_page import described
from viewer.app.application import App
from viewer.features.export.exporting import SUFFIXES, ExportPlan, ExportPreview
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import RenderSettings

BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


@pytest.fixture
def shown(app: App, pack: Pack, pack_folder: Path) -> App:
    app.show(pack, pack_folder)
    return app


@pytest.mark.parametrize("kind", SUFFIXES)
def test_all_choices_of_the_dialog_are_options_of_the_command(kind, tmp_path: Path, monkeypatch) -> None:
    asked = []
    monkeypatch.setattr(command, "export", lambda *words, **named: None)
    monkeypatch.setattr(command, "run_command", lambda commands, **named: asked.append(named["args"]) or 0)
    plan = ExportPlan(kind=kind, faces=100_000, spacing=0.5, keep="all", frame="world")
    words = plan.arguments(Path("pack"), tmp_path / "a.ply", BOX)
    assert command.main(words) == 0 and asked == [words]
    text = " ".join(words)
    assert "--crop=-1,-1,-1,1,1,1" in text
    assert ("--frame world" in text) == (kind != "page")
    assert ("--faces 100000" in text) == (kind == "mesh") and ("--spacing 0.5" in text) == (kind == "points")
    assert "--crop" not in " ".join(replace(plan, crop=False).arguments(Path("pack"), tmp_path / "a.ply", BOX))


def test_the_scene_is_exported_as_a_web_page(shown: App, tmp_path: Path) -> None:
    shown.exporting.ask(shown)
    shown.exporting.plan.kind = "page"
    shown.exporting.tick(shown)  # there is no preview of a page
    shown.exporting.choose_file(shown)
    assert shown.exporting.preview is None and shown.file_request is not None
    shown.file_request.then(tmp_path / "scene.html")
    until(lambda: shown.exporting.tick(shown) or shown.exporting.writing is None)
    assert not shown.messages.dialogs
    assert (tmp_path / "scene.html").read_text(encoding="utf-16").startswith("<!doctype html>")


def test_a_failure_is_a_dialog_with_the_commands_own_line(shown: App, tmp_path: Path) -> None:
    shown.set(crop=((5.0, 5.0, 5.0), (6.0, 6.0, 6.0)))
    shown.exporting.begin(shown, tmp_path / "mesh.glb")
    folder = not_none(shown.exporting.writing).folder
    until(lambda: shown.exporting.tick(shown) or shown.exporting.writing is None)
    dialog = shown.messages.dialogs[0]
    assert "mesh.glb was not written" in dialog.title and "nothing to export" in dialog.text
    assert not folder.exists() and not list(tmp_path.iterdir())


@pytest.mark.parametrize("ask", [lambda app: app.exporting.ask(app), lambda app: app.sharing.start(app)])
def test_what_is_no_pack_on_disk_cannot_be_exported_or_shared(app: App, pack: Pack, tmp_path: Path, ask) -> None:
    app.show(pack, tmp_path / "gone")
    with pytest.raises(UserError, match="not a pack on disk"):
        ask(app)


@pytest.mark.parametrize("how", ["cancelled", "the program ends"])
def test_an_export_that_is_ended_leaves_nothing(shown: App, tmp_path: Path, how: str) -> None:
    shown.exporting.begin(shown, tmp_path / "mesh.glb")
    writing = not_none(shown.exporting.writing)
    if how == "cancelled":
        shown.exporting.cancel()
        until(lambda: shown.exporting.tick(shown) or shown.exporting.writing is None)
        assert "was cancelled" in shown.messages.toast and not shown.messages.dialogs
    else:
        shown.exporting.end()
    assert not list(tmp_path.iterdir())
    assert writing.child.poll() is not None and not writing.folder.exists() and shown.exporting.writing is None


def finish(preview: ExportPreview, pack: Pack, export: Export) -> None:
    until(lambda: preview.follow(pack, export) or not preview.working)


def test_the_newest_choice_is_shown_and_older_ones_are_given_up(pack: Pack, monkeypatch) -> None:
    began, go, made = [], threading.Event(), []
    real = scene.preview_geometry

    def slow(pack: Pack, export: Export, tell):
        began.append(export.level)
        go.wait(60)
        tell(0.1, "")
        made.append(export.level)
        return real(pack, export, tell)

    monkeypatch.setattr(scene, "preview_geometry", slow)
    preview = ExportPreview()
    preview.follow(pack, Export("mesh", level=0.1))
    until(lambda: began == [0.1])
    for level in (0.2, 0.3, 0.4):
        preview.follow(pack, Export("mesh", level=level))
    assert preview.working and preview.geometry is None
    go.set()
    finish(preview, pack, Export("mesh", level=0.4))
    assert began == [0.1, 0.4] and made == [0.4]
    assert preview.geometry is not None and not preview.error and preview.news() and not preview.news()


@pytest.mark.parametrize("error", [UserError("a mesh needs scikit-image", remedy="install it"), MemoryError()])
def test_what_cannot_be_previewed_says_why(pack: Pack, monkeypatch, error: Exception) -> None:
    monkeypatch.setattr(scene, "preview_geometry", raising(error))
    preview = ExportPreview()
    finish(preview, pack, Export("mesh"))
    assert ("scikit-image" in preview.error) if isinstance(error, UserError) else ("memory" in preview.error)


@pytest.mark.parametrize("kind", scene.KINDS)
@pytest.mark.parametrize("parallel", [False, True])
def test_a_preview_is_seen_where_the_pack_is_in_its_colours(ctx, pack, kind, parallel) -> None:
    camera = ViewCamera.orbit(pack, 205.0, size=(160, 120))
    camera = camera.as_orthographic(2.6) if parallel else camera
    with closing(Canvas(ctx)) as canvas:
        canvas.show(pack)
        alpha = canvas.raw(camera, RenderSettings(mode="alpha", raw=True))[..., 0] > 0.5
        diffuse = canvas.snapshot(camera, RenderSettings(mode="diffuse"))
        drawn = canvas.draw_export_preview(scene.preview_geometry(pack, Export(kind)), camera, (0.0, 0.0, 0.0))
        seen = drawn.any(axis=2)
        assert (seen & alpha).sum() / (seen | alpha).sum() > 0.9  # points are squares that stick out
        assert (drawn.argmax(axis=2) == diffuse.argmax(axis=2))[seen & alpha].mean() > 0.95
        assert np.array_equal(canvas.snapshot(camera, RenderSettings(mode="diffuse")), diffuse), "nothing is left set"
        canvas.drop_export_preview()


@pytest.mark.slow
def test_the_scene_is_shared_as_it_is_seen_until_that_is_stopped(shown: App, pack: Pack) -> None:
    app, rig = shown, shown.open_scene.rig
    rig.turn(30, 10)
    rig.shown = goal = rig.goal
    app.filming.turntable(app)
    app.set(crop=((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0)))
    app.sharing.start(app)
    server = not_none(app.sharing.server)
    assert server.folder.is_dir()
    try:
        until(lambda: app.sharing.tick(app) or server.address != "")
        with urlopen(server.address, timeout=20) as answer:
            page = described(answer.read().decode())
        assert page["title"] == app.open_scene.name and page["path"]["frames"]
        assert page["levels"][-1]["box"][1][0] == pytest.approx(0.5 * pack.grid_size[0], abs=1)
        home = page["camera"]["home"]
        assert np.isclose(home["azimuth"] % 360, goal.azimuth % 360) and np.isclose(home["elevation"], goal.elevation)
    finally:
        app.sharing.end()
    assert app.sharing.server is None and not server.folder.exists()
    with pytest.raises(URLError):
        urlopen(server.address, timeout=20)


def test_sharing_that_ends_by_itself_is_told(shown: App) -> None:
    shown.sharing.start(shown)
    server = not_none(shown.sharing.server)
    server.child.kill()
    until(lambda: shown.sharing.tick(shown) or shown.sharing.server is None)
    assert "is not shared" in shown.messages.dialogs[0].title and not server.folder.exists()
