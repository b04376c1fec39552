"""What goes wrong outside of the program is a dialog in plain words; nothing is lost, and the viewer goes on."""

import errno
import os
import shutil
import threading

import numpy as np
import pytest
from PIL import Image

from tests.fuzz.trees import write_tree
from tests.stand_ins import raising
from tests.viewer.features.film.test_filming import needs_video
from tests.viewer.texture_limits import limit_textures
from tests.viewer.waiting import at_once, until
from viewer.features.opening import opening as loading_module


@pytest.fixture
def ui(offscreen, app, shapes_folder, tmp_path):
    """The interface with a pack that was opened from a folder of its own."""
    folder = shutil.copytree(shapes_folder, tmp_path / "open")
    app.resolution.enabled, app.resolution.rest_scale = False, 0.25
    ui = offscreen(app, size=(900, 560))
    app.open(folder)
    until(lambda: app.loading.finished)
    ui.settle()
    assert app.scene is not None
    return ui


def still_alive(ui) -> None:
    """The scene that was open is drawn, from another side too."""
    app = ui.app
    app.messages.dialogs.clear()
    before = ui.picture()
    at_once(app.scene.rig.orbit, 0.3, 0.1)
    ui.settle()
    assert np.abs(ui.picture().astype(int) - before).mean() > 1
    assert not app.messages.dialogs


def wait_for_dialog(ui) -> str:
    """Title and text of the dialog that something led to."""
    app = ui.app
    if app.loading is not None:
        until(lambda: app.loading.finished)
    until(lambda: ui.frame() or app.messages.dialogs)
    assert len(app.messages.dialogs) == 1
    dialog = app.messages.dialogs[0]
    for word in ("Errno", "Traceback", "Error", "<"):
        assert word not in dialog.text, dialog
    return f"{dialog.title}: {dialog.text}"


@pytest.mark.parametrize("gone", ["rgba_001.png", "scene_params.json", "all"])
def test_a_pack_deleted_while_open_stays_open_and_is_told_when_it_is_asked_for_again(ui, gone):
    app, folder = ui.app, ui.app.scene.path
    shutil.rmtree(folder) if gone == "all" else (folder / gone).unlink()
    still_alive(ui)
    scene = app.scene
    app.open(folder)
    assert "open cannot be opened" in wait_for_dialog(ui) and app.scene is scene
    app.messages.dialogs.clear()
    app.open(folder, other=True)
    assert str(folder) in wait_for_dialog(ui) and app.comparison.against == ""
    still_alive(ui)
    assert (folder in app.preferences.recent_packs()) == (gone != "all")


def test_a_pack_cut_off_while_it_is_seen_leads_to_the_start_page(offscreen, app, shapes_folder, tmp_path, monkeypatch):
    folder = shutil.copytree(shapes_folder, tmp_path / "cut")
    last = sorted(folder.glob("rgba_*.png"))[-1]
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])  # its header is whole
    seen, go_on, load = threading.Event(), threading.Event(), loading_module.load_pack

    def load_slowly(path, *, on_progress, on_preview, **_):
        def preview(pack):
            on_preview(pack)
            seen.set()
            go_on.wait(30)

        return load(path, on_progress=on_progress, on_preview=preview)

    monkeypatch.setattr(loading_module, "load_pack", load_slowly)
    ui = offscreen(app, size=(900, 560))
    app.open(folder)
    assert seen.wait(30)
    ui.frames(10)
    assert app.scene is not None and not app.scene.whole and ui.canvas.renderer is not None
    go_on.set()
    assert last.name in wait_for_dialog(ui)
    assert app.scene is None and ui.canvas.renderer is None and app.preferences.recent == []
    app.messages.dialogs.clear()
    monkeypatch.undo()
    app.open(shapes_folder)
    until(lambda: app.loading.finished)
    ui.settle()
    still_alive(ui)


@pytest.mark.parametrize("target", ["still.png", pytest.param("film.mp4", marks=needs_video), "frames"])
def test_a_full_disk_during_an_export_is_a_dialog_and_leaves_nothing_half_written(ui, tmp_path, monkeypatch, target):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(os, "fsync", raising(full))  # whatever is written cannot be flushed
    app, disk = ui.app, tmp_path / "disk"
    write_tree({"mine.txt": b"keep me"}, disk)
    app.filming.size, app.filming.fps = (96, 64), 1.0
    if target == "still.png":
        app.filming.still(app, disk / target)
    else:
        app.run("turntable")
        app.filming.film(app, disk / target)
    dialog = wait_for_dialog(ui)
    assert "The export stopped" in dialog and "the disk is full" in dialog and str(disk) in dialog
    assert app.filming.export is None
    assert [path.name for path in disk.iterdir()] == ["mine.txt"]
    still_alive(ui)


def test_a_card_with_too_little_room_shows_half_and_says_so_with_both_sizes(ui, shapes_folder, monkeypatch):
    app = ui.app
    scene = app.scene
    limit_textures(monkeypatch, most_bytes=1_000_000)
    app.open(shapes_folder)
    dialog = wait_for_dialog(ui)
    assert "70x70x70 voxels" in dialog and "35x35x35 voxels" in dialog and "half" in dialog and "MiB" in dialog
    assert app.scene is not scene and max(ui.canvas.renderer.pack.grid_size) == 35
    assert not app.messages.dialogs[0].failed
    still_alive(ui)


def test_dropping_what_is_no_pack_is_a_dialog_and_the_scene_stays(ui, tmp_path):
    app, scene = ui.app, ui.app.scene
    files = {"bad.zip": b"PK\x03\x04 and then nothing", "notes.txt": b"hello", "half/run/config.json": b"{"}
    write_tree({**files, "empty": "folder"}, tmp_path / "here")
    Image.new("RGB", (4, 4)).save(tmp_path / "here" / "cat.png")
    for name in ("bad.zip", "notes.txt", "empty", "cat.png", "half", "gone"):
        app.drop([tmp_path / "here" / name])
        assert name in wait_for_dialog(ui)
        assert app.scene is scene and app.making.plan is None
        still_alive(ui)
