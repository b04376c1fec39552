"""Real mouse, touch and key events move the page's camera as the desktop's moves; nothing is drawn while nothing moves."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenepack.pack import Pack
from tests.viewer.conftest import toy_pack
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.web.browser import Browser
from viewer.core.annotations import KEY, Annotations, Bookmark, Measurement, Scale, annotations_to_json
from viewer.core.pose import project
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.film.camera_path import CameraPath, Keyframe, save_path
from viewer.rendering.camera import ViewCamera
from viewer.web.description import PageContent

SIZE = (400, 300)


def annotated(pack: Pack, annotations: Annotations) -> Pack:
    return pack.with_metadata(**{KEY: annotations_to_json(annotations)})


def goal(browser: Browser) -> dict[str, Any]:
    return browser.evaluate("snerg.camera.goal")


def drag(browser: Browser, start: tuple[float, float], end: tuple[float, float], button: str = "left") -> None:
    browser.mouse("mousePressed", *start, button=button, clickCount=1)
    browser.mouse("mouseMoved", *end, button=button)
    browser.mouse("mouseReleased", *end, button=button, clickCount=1)


def settle(browser: Browser) -> None:
    browser.until("snerg.camera.shown === snerg.camera.goal && snerg.resting")


def assert_as_desktop(browser: Browser, rig: Any) -> None:
    settle(browser)
    view = browser.evaluate("snerg.camera.view(0)")
    matrix = rig.goal.matrix(rig.table)
    np.testing.assert_allclose(np.array(view["axes"]).T, matrix[:3, :3], atol=1e-6)
    np.testing.assert_allclose(view["eye"], matrix[:3, 3], atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("ndc", [False, True])
def test_the_mouse_moves_the_camera_as_the_desktops_does(ndc: bool, show) -> None:
    pack = shapes_pack(42, ndc=ndc)
    browser, rig = show(pack, size=SIZE), orbit_camera_for(pack)
    rig.go(replace(rig.home_pose, distance=goal(browser)["distance"]))
    before = browser.screenshot()
    dx, dy = 80 / SIZE[1], 30 / SIZE[1]
    drag(browser, (200, 150), (280, 180))
    rig.pan(dx, dy) if ndc else rig.orbit(dx, dy)
    assert_as_desktop(browser, rig)
    assert browser.screenshot() != before
    drag(browser, (200, 150), (280, 180), "right")
    rig.orbit(dx, dy) if ndc else rig.pan(dx, dy)
    assert_as_desktop(browser, rig)
    browser.mouse("mouseWheel", 300, 100, deltaX=0, deltaY=-200)
    rig.dolly(2, ((2 * 300 - 400) / 300, 1 - 2 * 100 / 300))
    assert_as_desktop(browser, rig)
    browser.key("keyDown", " ", "Space")  # forward-facing scenes have no turntable
    assert browser.evaluate("document.getElementById('play').ariaPressed === 'true'") is not ndc
    assert not browser.problems


@pytest.mark.slow
def test_one_finger_turns_two_fingers_move_and_zoom(show, shapes: Pack) -> None:
    browser = show(shapes, size=SIZE)
    browser.resize(*SIZE, touch=True)
    try:
        start = goal(browser)
        browser.touch("touchStart", (200, 150))
        browser.touch("touchMove", (240, 150))
        browser.touch("touchEnd")
        turned = goal(browser)
        assert turned["azimuth"] == pytest.approx(start["azimuth"] - 200 * 40 / SIZE[1])
        assert turned["pivot"] == start["pivot"] and turned["distance"] == start["distance"]
        browser.touch("touchStart", (180, 150), (220, 150))
        browser.touch("touchMove", (140, 150), (260, 150))
        browser.touch("touchEnd")
        pinched = goal(browser)
        assert pinched["distance"] == pytest.approx(turned["distance"] / 3, rel=1e-6)
        assert pinched["azimuth"] == turned["azimuth"]
        browser.touch("touchStart", (180, 150), (220, 150))
        browser.touch("touchMove", (180, 190), (220, 190))
        browser.touch("touchEnd")
        moved = goal(browser)
        assert moved["distance"] == pytest.approx(pinched["distance"], rel=0.1)
        assert np.linalg.norm(np.subtract(moved["pivot"], pinched["pivot"])) > 0.05 * moved["distance"]
        assert browser.evaluate("!snerg.camera.held && document.querySelectorAll('#bar button').length") == 6
        browser.touch("touchStart", (180, 260), (220, 260))  # on the bar
        for way in range(0, 80, 10):
            browser.touch("touchMove", (180 - way, 260), (220 + way, 260))
        browser.touch("touchEnd")
        assert browser.evaluate("visualViewport.scale") == 1, (
            "the browser enlarges the page, and the scene cannot undo it"
        )
    finally:
        browser.resize(*SIZE)


@pytest.mark.slow
def test_keys_fly_turn_choose_and_reset(show, shapes: Pack) -> None:
    browser = show(shapes, size=SIZE)
    start = goal(browser)
    browser.key("keyDown", "w")
    browser.until(f"snerg.camera.goal.pivot.some((v, i) => Math.abs(v - {start['pivot']}[i]) > 0.05)")
    browser.key("keyUp", "w")
    assert goal(browser)["distance"] == start["distance"]
    browser.key("keyDown", "ArrowLeft", "ArrowLeft")
    assert goal(browser)["azimuth"] == pytest.approx(start["azimuth"] + 15)
    browser.key("keyDown", "2")
    assert browser.evaluate("document.querySelector('#modes [aria-checked=true]').value") == "diffuse"
    browser.key("keyDown", "b")
    assert browser.evaluate("document.querySelector('#backgrounds [aria-checked=true]').title") == "White"
    browser.key("keyDown", "?", "Slash")
    assert browser.evaluate("!document.getElementById('keys').hidden")
    browser.evaluate("document.getElementById('display').click(); document.getElementById('near').focus()")
    browser.key("keyDown", "1")
    assert browser.evaluate("document.querySelector('#modes [aria-checked=true]').value") == "normal"
    browser.key("keyDown", "ArrowRight", "ArrowRight")  # moves the slider alone
    assert goal(browser)["azimuth"] == pytest.approx(start["azimuth"] + 15)
    browser.key("keyDown", "Escape", "Escape")
    assert browser.evaluate("document.getElementById('panel').hidden")
    browser.key("keyDown", "r")
    settle(browser)
    assert goal(browser) == start


@pytest.mark.slow
@pytest.mark.parametrize("size", [(844, 390), (1280, 400), (568, 270), (390, 844)])
def test_the_first_view_has_the_scene_beside_the_buttons(size: tuple[int, int], show, shapes: Pack) -> None:
    browser = show(shapes, size=size)
    left, top, right, bottom = browser.evaluate("""(() => {
        const [box, { axes, eye, fov }] = [document.getElementById("view"), snerg.camera.view(0)];
        const focal = box.clientHeight / 2 / Math.tan((fov * Math.PI) / 360);
        const seen = snerg.scene.camera.outline.map((point) => {
            const [x, y, z] = axes.map((axis) => axis.reduce((sum, v, i) => sum + v * (point[i] - eye[i]), 0));
            return [box.clientWidth / 2 - (focal * x) / z, box.clientHeight / 2 + (focal * y) / z];
        });
        return [Math.min, Math.max].flatMap((most) => [0, 1].map((i) => most(...seen.map((point) => point[i]))));
    })()""")
    assert left >= 0 and top >= 0 and right <= size[0] and bottom <= size[1]
    bar = browser.evaluate("document.getElementById('bar').getBoundingClientRect().toJSON()")
    assert bar["top"] >= 0 and bar["bottom"] <= size[1] and bar["right"] <= size[0]
    assert bar["top"] > bottom or bar["left"] > right


@pytest.mark.slow
def test_views_change_at_once_where_the_user_wants_little_motion(show, shapes: Pack, browser: Browser) -> None:
    with browser.before_scripts("window.matchMedia = () => ({ matches: true })"):
        show(shapes, size=SIZE)
        drag(browser, (200, 150), (280, 180))
        arrived = "snerg.camera.shown === snerg.camera.goal"
        frames = "requestAnimationFrame(() => requestAnimationFrame(done))"
        reset = "document.getElementById('reset').click()"
        assert browser.evaluate(f"new Promise((done) => {{ {reset}; {frames}; }}).then(() => {arrived})")


@pytest.mark.slow
def test_the_panel_says_what_is_shown_after_the_browser_went_back_to_the_page(show, shapes: Pack) -> None:
    browser = show(shapes, size=SIZE)
    browser.evaluate("document.getElementById('near').value = 0.5; document.getElementById('measurements').click()")
    browser.open("data:text/html,another")
    browser.evaluate("setTimeout(() => history.back())")
    browser.until("globalThis.snerg?.level && snerg.resting")
    shown = "[document.getElementById('near').value, document.getElementById('measurements').checked]"
    assert browser.evaluate(shown) == ["0", True] and browser.evaluate("snerg.camera.view(0).near") == 0


@pytest.mark.slow
@pytest.mark.parametrize("enabled", ["true", "false"])
def test_a_button_for_the_full_screen_is_there_where_it_works(enabled, show, shapes, browser):
    with browser.before_scripts(f"Object.defineProperty(document, 'fullscreenEnabled', {{ value: {enabled} }})"):
        show(shapes, size=SIZE)
        assert browser.evaluate("document.getElementById('fullscreen').hidden") is (enabled == "false")


@pytest.mark.slow
def test_nothing_is_drawn_while_nothing_moves_and_the_picture_at_rest_is_sharp(show, shapes: Pack) -> None:
    browser = show(shapes, size=SIZE)
    browser.key("keyDown", "h")  # hides the buttons
    drag(browser, (200, 150), (210, 155))
    settle(browser)
    browser.evaluate("""(() => {
        window.draws = 0;
        const draw = WebGL2RenderingContext.prototype.drawArrays;
        WebGL2RenderingContext.prototype.drawArrays = function (...words) { window.draws++; return draw.apply(this, words); };
    })()""")
    assert browser.evaluate("new Promise((done) => setTimeout(() => done(window.draws), 700))") == 0
    shown = np.asarray(Image.open(io.BytesIO(browser.screenshot()), formats=["PNG"]).convert("RGB")).astype(int)
    drawn = browser.evaluate(f"Array.from(snerg.picture(snerg.camera.view(0), {{}}, {SIZE[0]}, {SIZE[1]}).data)")
    difference = np.abs(np.reshape(drawn, (SIZE[1], SIZE[0], 4))[..., :3] - shown)
    assert difference.max() <= 1, "the screen does not show the picture of every pixel"


@pytest.mark.slow
def test_bookmarks_are_buttons_and_a_camera_path_is_played(show, shapes: Pack, tmp_path: Path) -> None:
    file = tmp_path / "path.json"
    views = (
        Bookmark("From above", (0.0, 3.0, 0.1), (0.0, 0.0, 0.0)),
        Bookmark("z up", (2.0, 0.0, 1.0), (0.0, 0.0, 0.2), "z", 50.0),
    )
    pack = annotated(shapes, Annotations(bookmarks=views))
    keys = [ViewCamera.orbit(pack, azimuth, 20, 3.0).grid_T_camera for azimuth in (0, 40, 80)]
    save_path(CameraPath([Keyframe(key, 40.0, 0.5) for key in keys]), file, pack.worldspace_T_opengl, SIZE, 30)
    browser = show(pack, PageContent("Two views", path=file), size=SIZE)
    buttons = "[...document.querySelectorAll('#bookmarks button')]"
    assert browser.evaluate(f"{buttons}.map((each) => each.textContent)") == ["From above", "z up"]
    for i, view in enumerate(views):
        browser.evaluate(f"{buttons}[{i}].click()")
        settle(browser)
        seen = browser.evaluate("snerg.camera.view(0)")
        np.testing.assert_allclose(seen["eye"], view.eye, atol=1e-6)
        expected = np.subtract(view.eye, view.target) / np.linalg.norm(np.subtract(view.eye, view.target))
        np.testing.assert_allclose(seen["axes"][2], expected, atol=1e-6)
        assert seen["fov"] == view.fov
    browser.evaluate("document.getElementById('play').click()")
    browser.until("snerg.camera.held")
    browser.until("document.getElementById('play').ariaPressed === 'false' && snerg.resting")
    last = browser.evaluate("snerg.camera.held")
    np.testing.assert_allclose(last["eye"], keys[-1][:3, 3], atol=1e-5)
    np.testing.assert_allclose(np.array(last["axes"]).T, keys[-1][:3, :3], atol=1e-5)
    drag(browser, (200, 150), (210, 155))
    assert browser.evaluate("snerg.camera.held") is None


@pytest.mark.slow
def test_annotated_places_are_numbers_that_hide_when_covered_and_say_their_text_when_clicked(show) -> None:
    pack = toy_pack()
    ball, post = (0.0, -0.25, 0.4), (0.5, 0.39, 0.0)
    words = "Second line <b>\nafter the first"
    views = (
        Bookmark("A view", (0.0, 3.0, 0.1), (0.0, 0.0, 0.0)),
        Bookmark("The ball", (0.0, 0.5, 3.0), (0.0, 0.0, 0.0), point=ball, text=words),
        Bookmark("The post", (3.0, 0.5, 0.0), (0.0, 0.0, 0.0), point=post),
    )
    pose = '{"eye": [0, 0.2, 4], "target": [0, 0, 0], "fov": 40}'
    browser = show(annotated(pack, Annotations(bookmarks=views)), PageContent("x", pose=pose), size=SIZE)
    marks = "[...document.querySelectorAll('#overlay .place')]"
    shown = f"{marks}.map((each) => [each.textContent, each.style.display])"
    browser.until("snerg.resting")
    assert browser.evaluate(shown) == [["2", ""], ["3", ""]]
    at = browser.evaluate(f"{marks}.map((each) => each.getAttribute('transform').match(/[-.0-9]+/g).map(Number))")
    camera = ViewCamera.look_at(np.array([0, 0.2, 4.0]), np.zeros(3), np.array([0, 1.0, 0]), 40.0, SIZE)
    np.testing.assert_allclose(at, project(camera, np.array([ball, post]))[0], atol=0.5)
    (x, y), start = at[1], goal(browser)["azimuth"]
    drag(browser, (x, y), (x + 60, y))  # from a number as from anywhere else, and a finger as the mouse
    assert goal(browser)["azimuth"] == pytest.approx(start - 200 * 60 / SIZE[1])
    browser.evaluate("document.getElementById('reset').click()")
    settle(browser)
    browser.resize(*SIZE, touch=True)
    browser.touch("touchStart", (x, y))
    for way in range(10, 70, 10):
        browser.touch("touchMove", (x - way, y))
    browser.touch("touchEnd")
    assert goal(browser)["azimuth"] == pytest.approx(start + 200 * 60 / SIZE[1])
    browser.resize(*SIZE)
    browser.evaluate("document.getElementById('reset').click()")
    settle(browser)
    drag(browser, (x, y), (x + 1, y))  # a click, by a hand that shakes
    settle(browser)
    np.testing.assert_allclose(browser.evaluate("snerg.camera.view(0)")["eye"], views[2].eye, atol=1e-6)
    browser.evaluate(f"{marks}[0].dispatchEvent(new MouseEvent('click'))")
    settle(browser)
    np.testing.assert_allclose(browser.evaluate("snerg.camera.view(0)")["eye"], views[1].eye, atol=1e-6)
    note = "['note-title', 'note-text'].map((id) => document.getElementById(id).textContent)"
    assert browser.evaluate(note) == ["The ball", words]
    assert browser.evaluate("document.getElementById('note').hidden") is False
    for closed_by in ("note", "reset"):
        browser.evaluate(f"{marks}[0].dispatchEvent(new MouseEvent('click'))")
        browser.evaluate(f"document.getElementById('{closed_by}').click()")
        assert browser.evaluate("document.getElementById('note').hidden"), closed_by
    settle(browser)
    before = goal(browser)["distance"]
    browser.mouse("mouseWheel", *at[1], deltaX=0, deltaY=-100)
    assert goal(browser)["distance"] == pytest.approx(0.9 * before)
    for azimuth, hidden in ((180.0, True), (0.0, False)):  # from behind the ball, and from before it
        browser.evaluate(f"snerg.camera.goal = {{...snerg.camera.goal, azimuth: {azimuth}, elevation: 0}}")
        browser.key("keyDown", "+")
        settle(browser)
        assert browser.evaluate(shown) == [["2", "none" if hidden else ""], ["3", ""]], azimuth
    assert not browser.problems


def test_the_first_view_the_credits_and_measurements_come_along(show, shapes: Pack) -> None:
    line = Measurement("line", ((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    behind = Measurement("point", ((0.0, 0.0, 9.0),))
    notes = Annotations(Scale(0.5, "m"), (line, behind))
    pose = '{"eye": [0, 0.5, 2], "target": [0, 0, 0], "fov": 40}'  # in metres, half as many as grid units
    content = PageContent("x", "Photographs: <b>A. B.</b>", pose=pose)
    browser = show(annotated(shapes, notes), content, size=SIZE)
    start = browser.evaluate("snerg.camera.view(0)")
    np.testing.assert_allclose(start["eye"], (0, 1, 4), atol=1e-6)
    assert start["fov"] == 40
    assert browser.evaluate("document.getElementById('credits').textContent") == "Photographs: <b>A. B.</b>"
    browser.until("getComputedStyle(document.getElementById('notice')).visibility === 'hidden'")  # for screen readers
    labels = "[...document.querySelectorAll('#overlay text')]"
    texts = browser.evaluate(f"{labels}.map((each) => [each.textContent, each.style.display])")
    assert texts == [["1.00 m", ""], [texts[1][0], "none"]]
    camera = ViewCamera.look_at(np.array([0, 1, 4.0]), np.zeros(3), np.array([0, 1.0, 0]), 40.0, SIZE)

    def drawn() -> list[list[float]]:
        dots = "[...document.querySelectorAll('#overlay circle')].slice(0, 2)"
        return browser.evaluate(f"{dots}.map((dot) => [dot.getAttribute('cx'), dot.getAttribute('cy')].map(Number))")

    expected = project(camera, np.array(line.points))[0]
    np.testing.assert_allclose(drawn(), expected, atol=0.01)
    drag(browser, (200, 150), (280, 180))
    settle(browser)
    assert np.abs(np.subtract(drawn(), expected)).max() > 5
    browser.key("keyDown", "r")
    settle(browser)
    np.testing.assert_allclose(drawn(), expected, atol=0.1)
    assert not browser.problems
