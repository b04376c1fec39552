"""What people do with the viewer, on the window itself under real events: keys of all layouts, axis views, measuring, sessions,
pictures and scenes taken away, and scenes made of photographs. What takes long when one is made is a stand-in.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import glfw
import numpy as np
import pytest
from imgui_bundle import icons_fontawesome_6 as fa
from PIL import Image

from tests.training.posing.conftest import COUNT, write_photographs
from tests.training.reconstructions import around, ball, write_colmap
from tests.viewer.conftest import missing
from tests.viewer.window.living import place_of, press, pump, type_path, wait
from viewer.app.application import App
from viewer.core import widgets
from viewer.core.annotations import Scale
from viewer.core.pose import Pose, project, shortest_turn
from viewer.features.camera import panel as camera_panel
from viewer.features.camera.walking import metre_of
from viewer.features.crop import crop
from viewer.features.making import survey
from viewer.features.making.make_plan import Plan
from viewer.window.window import Window

SLOW_FRAME_S = 0.2

QUICK = 12

KEYCODE = {"Q": 24, "W": 25, "E": 26, "A": 38, "S": 39, "D": 40, "M": 58, "Z": 52}  # evdev's, by place

NUMBER_BLOCK = {"1": 87, "2": 88, "3": 89, "4": 83, "5": 84, "6": 85, "7": 79, "8": 80, "9": 81}  # evdev's keycodes

FAKE = Path(__file__).parents[1] / "features" / "making" / "fake_make.py"


@pytest.fixture
def slow_frames(monkeypatch):
    """Frames as they are on a slow card: whole keystrokes come and go within one."""
    swap = glfw.swap_buffers

    def slowly(handle) -> None:
        time.sleep(SLOW_FRAME_S)
        swap(handle)

    monkeypatch.setattr(glfw, "swap_buffers", slowly)


@pytest.fixture
def during_frames(window, display):
    """Has xdotool send events while the window draws frame after frame, until it has sent them all."""
    program = shutil.which("xdotool")
    if program is None:
        missing("xdotool")

    def call(*words: object) -> None:
        command = [str(program), *(str(word) for word in words)]
        sender = subprocess.Popen(command, env={**os.environ, "DISPLAY": display}, stdout=subprocess.DEVNULL)
        while sender.poll() is None:
            window.app.touch(1)
            window.step()
        assert sender.returncode == 0

    return call


@pytest.fixture
def french(display, window):
    """The French layout, which has Z, Q and A where a US keyboard has W, A and Q."""
    program = shutil.which("setxkbmap")
    if program is None:
        missing("setxkbmap")

    def use(layout: str) -> None:
        subprocess.run([str(program), "-display", display, layout], check=True, stderr=subprocess.DEVNULL)
        pump(window, 0.3)

    use("fr")
    wait(window, lambda: glfw.get_key_name(glfw.KEY_W, 0) == "z")
    yield
    use("us")


def test_every_quick_paste_is_a_paste_and_none_is_a_v(window, slow_frames, during_frames):
    pasted = []
    window.app.paste_pose = lambda: pasted.append(window.app.scene.rig.flying)
    for _ in range(QUICK):
        quick_paste(during_frames)
        window.step()
    assert pasted == [False] * QUICK and not window.app.scene.rig.flying


def quick_paste(during_frames) -> None:
    """Ctrl first; then, within one frame, V, and Ctrl is let go of before V is."""
    during_frames("keydown", "ctrl")
    during_frames("keydown", "v", "keyup", "ctrl", "keyup", "v")


def test_what_is_typed_fast_into_a_field_is_there_at_once_and_runs_no_command(window, slow_frames, during_frames):
    during_frames("key", "ctrl+shift+o")
    wait(window, lambda: window.app.file_request is not None and window.ui.typing)
    text = "/vvrf n?k1b2/this is no folder"
    during_frames("type", "--delay", 1, text)
    for _ in range(2):  # all that is left in the queue comes with the next frame
        window.app.touch(1)
        window.step()
    assert window.ui.file_dialogs._text == text
    app = window.app
    assert not app.scene.rig.flying and app.settings.mode == "normal" and not app.interface.help_shown
    during_frames("key", "Escape")
    wait(window, lambda: app.file_request is None)


def moved(window: Window, xdotool, keycode: int | str) -> np.ndarray:
    """How the flying camera moves, along its own axes, while a key is held."""
    rig = window.app.scene.rig
    before, rotation = rig.goal.eye(rig.table), rig.goal.rotation(rig.table)
    xdotool("keydown", keycode)
    wait(window, lambda: np.linalg.norm(rig.goal.eye(rig.table) - before) > 0.02 * rig.radius)
    xdotool("keyup", keycode)
    pump(window, 0.2)
    return (rig.goal.eye(rig.table) - before) @ rotation


AXES = {"D": (0, 1), "A": (0, -1), "E": (1, 1), "Q": (1, -1), "S": (2, 1), "W": (2, -1)}  # camera axes: z is back


def test_flying_goes_by_the_places_of_keys_on_a_french_keyboard(window, xdotool, act, french):
    act("key", "v")
    assert window.app.scene.rig.flying
    for place, (axis, sign) in AXES.items():
        way = moved(window, xdotool, KEYCODE[place])
        assert np.argmax(np.abs(way)) == axis and np.sign(way[axis]) == sign, place
    assert window.app.keyboard.flying_names == ("Z", "Q", "S", "D", "A", "E")
    assert "Z Q S D, A and E" in window.app.messages.toast


def test_commands_go_by_names_and_characters_on_a_french_keyboard(window, xdotool, act, french):
    rig = window.app.scene.rig
    xdotool("key", 11)  # the place of 2, which types é
    wait(window, lambda: rig.goal.azimuth == 90)
    xdotool("keydown", "ctrl", "key", KEYCODE["W"], "keyup", "ctrl")  # Z is printed there
    wait(window, lambda: rig.goal.azimuth != 90)
    xdotool("keydown", "shift", "key", KEYCODE["M"], "keyup", "shift")  # ? is printed there
    wait(window, lambda: window.app.interface.help_shown)
    act("key", KEYCODE["M"])
    assert window.app.interface.help_shown


def test_the_arrow_keys_turn_slide_and_fly(window, xdotool, act):
    rig = window.app.scene.rig
    start = rig.goal
    xdotool("keydown", "Right")
    wait(window, lambda: abs(rig.goal.azimuth - start.azimuth) > 5)
    act("keyup", "Right")
    turned = rig.goal
    assert turned.azimuth > start.azimuth and turned.pivot == start.pivot  # the camera goes to the right
    xdotool("keydown", "shift", "keydown", "Up")
    wait(window, lambda: rig.goal.pivot != turned.pivot)
    act("keyup", "Up", "keyup", "shift")
    assert rig.goal.pivot[1] > turned.pivot[1] and rig.goal.azimuth == turned.azimuth
    for expected in (turned, start):  # each way is one step
        xdotool("key", "ctrl+z")
        wait(window, lambda goal=expected: rig.goal == goal)
    act("key", "v")
    for arrow, place in (("Up", "W"), ("Down", "S"), ("Left", "A"), ("Right", "D")):
        axis, sign = AXES[place]
        way = moved(window, xdotool, arrow)
        assert np.argmax(np.abs(way)) == axis and np.sign(way[axis]) == sign, arrow


def test_on_foot_keys_walk_up_to_the_ball_and_jump_and_the_mouse_looks_around(window, xdotool):
    app, rig = window.app, window.app.scene.rig
    app.walking.eye_height_m = 0.2 / metre_of(app.scene.pack, rig, Scale())
    xdotool("key", "g")
    wait(window, lambda: rig.walking)
    rig.stand_at(np.array([0.0, -0.4, 0.75]), Pose())  # above the plate's edge, with the ball ahead
    app.walking.stands = False  # it stood where it came from; now it has to land
    wait(window, lambda: app.walking.stands)
    level = rig.goal.eye(rig.table)
    xdotool("keydown", "w")
    wait(window, lambda: rig.goal.eye(rig.table)[2] < level[2] - 0.2)
    pump(window, 0.5)
    xdotool("keyup", "w")
    pump(window)
    before_ball = rig.goal.eye(rig.table)
    assert 0.3 < before_ball[2] < 0.55 and abs(before_ball[1] - level[1]) < 0.02
    xdotool("keydown", "e")
    wait(window, lambda: rig.goal.eye(rig.table)[1] > level[1] + 0.03)
    xdotool("keyup", "e")
    wait(window, lambda: app.walking.stands)
    azimuth = rig.goal.azimuth
    xdotool("mousemove", 200, 300, "mousedown", 1)
    pump(window)
    xdotool("mousemove", 260, 300)
    pump(window)
    xdotool("mouseup", 1)
    pump(window)
    assert rig.goal.azimuth != azimuth and np.allclose(rig.goal.eye(rig.table), before_ball, atol=0.02)
    xdotool("key", "g")
    wait(window, lambda: not rig.walking)
    assert not app.messages.dialogs


def looks_from(rig, azimuth: float, elevation: float) -> bool:
    """Whether the camera has come to rest on that side."""
    there = abs(shortest_turn(rig.shown.azimuth, azimuth)) < 0.1 and abs(rig.shown.elevation - elevation) < 0.1
    return there and rig.shown == rig.goal


@pytest.mark.parametrize(
    ("keys", "azimuth", "elevation"),
    [
        (["3"], 90, 0),
        (["ctrl", "7"], 0, -90),
        (["1", "9"], 180, 0),
        (["1", "6", "8", "8"], 15, 30),
    ],
)
def test_the_number_block_shows_the_views_that_blender_shows(window, xdotool, keys, azimuth, elevation):
    rig = window.app.scene.rig
    for key in keys:
        if key == "ctrl":
            xdotool("keydown", "ctrl")
        else:
            before = rig.goal
            xdotool("key", NUMBER_BLOCK[key])
            wait(window, lambda before=before: rig.goal != before)
    xdotool("keyup", "ctrl")
    wait(window, lambda: looks_from(rig, azimuth, elevation))
    assert not rig.flying and not window.app.messages.dialogs


def test_a_click_on_an_axis_looks_along_it_and_a_drag_of_the_gizmo_orbits(window, xdotool, act):
    app, rig = window.app, window.app.scene.rig

    def places() -> np.ndarray:
        radius, rim = camera_panel.RADIUS, widgets.CARD_MARGIN + camera_panel.RADIUS + camera_panel.BALL
        view = app.viewport
        middle = np.array([view.x + view.width - rim, view.y + rim])
        return middle + radius * camera_panel.axis_ends(rig.matrix[:3, :3])[:, :2]

    for end, (azimuth, elevation) in ((0, (90, 0)), (5, (180, 0)), (1, (0, 90))):
        rig.home()
        wait(window, lambda: rig.shown == rig.goal)
        x, y = places()[end]
        xdotool("mousemove", round(x), round(y), "click", 1)
        wait(window, lambda a=azimuth, e=elevation: looks_from(rig, a, e))
    before = rig.goal
    assert rig.history.undo() and rig.goal != before  # a click is one step
    act("mousemove", round(x), round(y), "mousedown", 1)
    start = rig.goal
    xdotool("mousemove", round(x) - 60, round(y) + 20)
    wait(window, lambda: rig.goal.azimuth != start.azimuth)
    act("mouseup", 1)
    assert rig.goal.pivot == start.pivot


def test_m_measures_between_clicks_and_the_result_is_on_the_clipboard(window, xdotool, act):
    app = window.app
    xdotool("mousemove", *place_of(window, (0.0, -0.25, 0.0)), "key", "m")
    wait(window, lambda: app.measure_tool.tool == "line" and app.interface.page == "measure")
    app.scene.rig.frame()
    app.scene.rig.shown = app.scene.rig.goal
    wait(window, lambda: app.measure_tool.cursor is not None)  # the ball
    for i, point in enumerate(((-0.15, -0.25, 0.0), (0.2, -0.1, 0.0), (0.0, -0.45, 0.0)), 1):
        xdotool("mousemove", *place_of(window, point), "click", 1)
        wait(window, lambda i=i: len(app.measure_tool.draft) == i)
    xdotool("key", "BackSpace")
    wait(window, lambda: len(app.measure_tool.draft) == 2)
    xdotool("key", "Return")
    wait(window, lambda: len(app.annotations.current.measurements) == 1)
    xdotool("key", "ctrl+shift+c")
    wait(window, lambda: app.clipboard.get().startswith("line 1: 0."))
    before = app.annotations.current.measurements[0].points[0]
    goal = app.scene.rig.goal
    act("mousemove", *place_of(window, before), "mousedown", 1)
    act("mousemove_relative", 0, 25)
    xdotool("mouseup", 1)
    wait(window, lambda: app.annotations.current.measurements[0].points[0] != before)
    assert app.scene.rig.goal == goal
    xdotool("key", "Escape", "key", "ctrl+z")
    wait(window, lambda: not app.measure_tool.tool and app.annotations.current.measurements[0].points[0] == before)
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_a_session_is_saved_and_opened_again(window, xdotool, act, tmp_path):
    app = window.app
    file = tmp_path / "here.snerg"
    xdotool("mousemove", 200, 300, "key", "3")
    wait(window, lambda: app.scene.rig.shown == app.scene.rig.goal and app.scene.rig.goal.elevation > 80)
    seen = app.scene.rig.matrix.copy()
    xdotool("key", "ctrl+d", "key", "ctrl+shift+s")
    wait(window, lambda: app.file_request is not None)
    pump(window)
    act("key", "ctrl+a", "type", "--delay", 20, str(file))
    xdotool("key", "Return")
    wait(window, file.exists)
    assert not app.messages.dialogs
    again = type(app)(canvas=window.canvas)
    again.clipboard, window.app = app.clipboard, again
    window.canvas.show(None)
    xdotool("mousemove", 200, 300, "key", "ctrl+o")
    wait(window, lambda: again.open_prompt is not None)
    pump(window)
    act("type", "--delay", 20, str(file))
    xdotool("key", "Return")
    wait(window, lambda: again.scene is not None and again.scene.whole and again.loading is None)
    assert np.allclose(again.scene.rig.matrix, seen, atol=1e-6)
    assert [view.name for view in again.annotations.current.bookmarks] == ["View 1"]
    assert not again.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_a_view_is_saved_in_several_modes_and_as_exr(film_page, watched, xdotool, tmp_path):
    window, app = film_page, film_page.app
    for name in ("##transparent", "##depth", "##normals"):
        press(watched, xdotool, name)
    assert app.filming.transparent and set(app.filming.besides) == {"depth", "normals"}
    press(watched, xdotool, "Save this view…")
    type_path(window, xdotool, tmp_path / "view.png")
    wait(window, lambda: app.filming.export is None and len(list(tmp_path.glob("*.png"))) == 3)
    assert {path.name for path in tmp_path.iterdir()} == {"view_rgb.png", "view_depth.png", "view_normals.png"}
    picture = Image.open(tmp_path / "view_rgb.png")
    assert picture.mode == "RGBA" and picture.size == (96, 64)
    assert picture.getpixel((0, 0)) == (0, 0, 0, 0) and np.asarray(picture)[..., 3].max() == 255
    xdotool("key", "ctrl+s")
    type_path(window, xdotool, tmp_path / "view.exr")
    wait(window, (tmp_path / "view.exr").exists)
    OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed: pip install 'snerg[export]'")
    file = OpenEXR.File(str(tmp_path / "view.exr"), separate_channels=True)
    assert set(file.channels()) == {"R", "G", "B", "A", "Z", "N.X", "N.Y", "N.Z"}
    depth = file.channels()["Z"].pixels
    radius = app.scene.rig.goal.distance
    assert 0.3 * radius < np.median(depth[depth > 0]) < 1.5 * radius
    assert json.loads(file.header()["snerg"])["fx"] > 0
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_another_program_pastes_the_picture_that_was_copied(window, xdotool, other_client, tmp_path):
    app = window.app
    for mode in ("normal", "diffuse"):  # the second takes the place of the first
        app.set(mode=mode)
        pump(window)
        xdotool("key", "ctrl+i")
        wait(window, lambda: app.messages.lines[-1].text == "The picture is on the clipboard")
        app.messages.log("pasted")
        other_client("paste", tmp_path / "pasted.png")
        pasted = np.asarray(Image.open(tmp_path / "pasted.png").convert("RGB"))
        assert np.array_equal(pasted, window.canvas.snapshot(app.camera(), app.settings))
    assert not app.messages.dialogs


def test_the_scene_is_exported_within_the_crop_box_and_can_be_cancelled(film_page, watched, xdotool, tmp_path):
    window, app = film_page, film_page.app
    app.set(crop=((-1.0, -1.0, -1.0), (1.0, -0.5, 1.0)))  # the plate
    xdotool("key", "ctrl+e")
    wait(window, lambda: app.exporting.asking)
    press(watched, xdotool, "Points##kind")
    wait(window, lambda: app.exporting.plan.kind == "points")
    press(watched, xdotool, "Sparse##spacing")
    wait(window, lambda: app.exporting.plan.spacing == 2.0)
    press(watched, xdotool, "Export…")
    type_path(window, xdotool, tmp_path / "plate.ply")
    goal = app.scene.rig.goal
    assert app.exporting.writing is not None
    xdotool("key", "2")  # the window lives on meanwhile
    wait(window, lambda: app.scene.rig.goal != goal)
    wait(window, lambda: app.exporting.writing is None)
    assert not app.messages.dialogs
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: the extra dev")
    cloud = trimesh.load(tmp_path / "plate.ply")
    assert len(cloud.vertices) > 50 and cloud.bounds[1, 1] <= -0.5 + 2 / 44
    assert np.ptp(cloud.vertices[:, 0]) > 1.5

    xdotool("key", "ctrl+e")
    wait(window, lambda: app.exporting.asking)
    press(watched, xdotool, "Mesh##kind")
    xdotool("key", "Return")
    type_path(window, xdotool, tmp_path / "mesh.glb")
    press(watched, xdotool, "Cancel##export")
    wait(window, lambda: app.exporting.writing is None)
    assert {path.name for path in tmp_path.iterdir()} <= {"plate.ply", "mesh.glb"}
    assert not app.messages.dialogs and window.ctx.error == "GL_NO_ERROR"


def test_bare_photographs_that_are_dropped_are_shown_with_what_is_set_aside_and_the_time_it_takes(
    start_page, other_client, act, tmp_path
):
    window = start_page
    photographs = tmp_path / "attic"
    write_photographs(photographs)
    (photographs / "p0b.jpg").write_bytes((photographs / "p0.jpg").read_bytes())
    other_client("drop", photographs)
    wait(window, lambda: not window.app.making.busy)
    pump(window)
    preview = window.app.making.plan.survey.preview
    assert preview.count == COUNT + 1 and preview.aside == {"p0b.jpg": "the same as p0.jpg"}
    assert set(preview.seconds) == {"pictures", "features", "matches", "poses"} and preview.seconds["features"] > 0
    assert len(preview.boxes) == COUNT + 1 and not preview.error
    dialog = window.screenshot()
    assert blue_pixels(dialog) > 300  # of the photographs; nothing else there is blue
    assert window.app.making.plan.problem() is None
    act("key", "Escape")
    assert window.app.making.plan is None
    wait(window, lambda: preview.finished)


def test_photographs_are_checked_from_the_dialog_and_the_page_opens_in_the_browser(
    watched, start_page, other_client, xdotool, tmp_path, monkeypatch
):
    window, opened = start_page, []
    monkeypatch.setattr(survey.webbrowser, "open", lambda address: opened.append(address) or True)
    write_photographs(tmp_path / "attic")
    other_client("drop", tmp_path / "attic")
    wait(window, lambda: not window.app.making.busy)
    press(watched, xdotool, "Check photographs")
    press(watched, xdotool, "Stop##check")
    assert window.app.making.check is None
    press(watched, xdotool, "Check photographs")
    wait(window, lambda: window.app.making.check.result is not None)
    press(watched, xdotool, "Open the page")
    page = tmp_path / "attic-snerg" / "check.html"
    wait(window, lambda: opened == [page.as_uri()])
    assert page.is_file() and not window.app.messages.dialogs


def drawn_pixels(picture: np.ndarray, app: App) -> int:
    """How many pixels in the upper half of the viewport are other than its white background."""
    box = app.viewport
    seen = picture[round(box.y) : round(box.y + 0.5 * box.height), round(box.x) : round(box.x + box.width)]
    return int((seen.min(axis=-1) < 200).sum())


def blue_pixels(picture: np.ndarray) -> int:
    """How many pixels of uint8 [H, W, 3] are far more blue than anything else."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return int((blue > np.maximum(red, green) + 40).sum())


def test_points_and_cameras_are_shown_and_a_face_of_the_box_is_dragged_before_training(
    watched, start_page, other_client, xdotool, act, tmp_path, monkeypatch
):
    window = start_page
    glfw.set_window_size(window.handle, 1000, 700)
    photographs = tmp_path / "attic"
    write_photographs(photographs)
    found = write_colmap(tmp_path / "found", around(), ball(radius=1.0))
    command, real = Plan.command, []

    def stand_in(plan: Plan) -> list[str]:
        real.append(command(plan))
        copy = f"import shutil; shutil.copytree({str(found)!r}, {str(plan.posed)!r})"
        return [sys.executable, "-c", copy] if plan.poses_only else [sys.executable, str(FAKE), "wait", str(tmp_path)]

    monkeypatch.setattr(Plan, "command", stand_in)
    other_client("drop", photographs)
    wait(window, lambda: not window.app.making.busy)  # the question has its last size
    pump(window)
    app = window.app
    press(watched, xdotool, "Make it")
    assert app.making.plan is None
    wait(window, lambda: app.making.review is not None)
    pump(window)
    assert "--poses-only" in real[0] and app.making.sparse_preview_shown(app)
    wait(window, lambda: len(app.gallery.thumbnails.boxes) == 10)  # the photographs in their frusta
    pump(window)
    assert drawn_pixels(window.screenshot(), app) > 500
    box = app.viewport
    left, top = glfw.get_window_pos(window.handle)
    start = app.scene.rig.goal
    x, y = left + round(box.x + 0.5 * box.width), top + round(box.y + 0.2 * box.height)
    act("mousemove", x, y, "mousedown", 1)
    act("mousemove", x + 60, y + 10)
    act("mouseup", 1)
    assert app.scene.rig.goal.azimuth != start.azimuth
    assert app.making.review.kind == "subject"
    press(watched, xdotool, "##box")
    wait(window, lambda: app.settings.crop is not None and app.scene.rig.shown == app.scene.rig.goal)
    pump(window)
    before = app.settings.crop
    handle, _ = project(app.camera(), crop.face_centre(before, 3)[None])  # the upper face
    x, y = (float(v) / app.viewport.pixels_per_unit for v in np.asarray(handle).reshape(-1)[:2])
    x, y = left + round(app.viewport.x + x), top + round(app.viewport.y + y)
    act("mousemove", x, y)
    act("mousedown", 1)
    act("mousemove", x, y + 40)
    act("mouseup", 1)
    assert app.settings.crop[1][1] < before[1][1] and app.settings.crop[0] == before[0]
    assert app.making.review.seconds_left is None  # somebody is there
    press(watched, xdotool, "Train it")
    wait(window, lambda: app.making.job is not None and app.making.job.report is not None)
    pump(window)
    words = real[-1]
    top_of_box = float(words[words.index("--aabb") + 1].split(",")[-1])
    assert abs(top_of_box - app.making.job.plan.aabb[5]) < 1e-3 and app.settings.crop is None
    assert app.making.sparse_preview_shown(app)  # while the field trains


def test_the_scene_is_shared_and_that_is_stopped(film_page, watched, xdotool):
    window, app = film_page, film_page.app
    xdotool("key", "ctrl+e")
    wait(window, lambda: app.exporting.asking)
    press(watched, xdotool, "Web page##kind")
    wait(window, lambda: app.exporting.plan.kind == "page")
    press(watched, xdotool, f"{fa.ICON_FA_SHARE_NODES}  Share…")
    wait(window, lambda: app.sharing.server is not None and app.sharing.server.address)
    assert not app.exporting.asking
    server = app.sharing.server
    with urlopen(server.address, timeout=20) as answer:
        assert answer.read().startswith(b"<!doctype html>")
    press(watched, xdotool, f"{fa.ICON_FA_COPY}  Copy##address")
    wait(window, lambda: app.clipboard.get() == server.address)
    press(watched, xdotool, "Stop##sharing")
    wait(window, lambda: app.sharing.server is None)
    with pytest.raises(URLError):
        urlopen(server.address, timeout=20)
    assert not app.messages.dialogs
