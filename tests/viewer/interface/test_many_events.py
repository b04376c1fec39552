"""Random but plausible use, and opening many packs: nothing breaks and nothing is left behind."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from imgui_bundle import imgui

from tests.viewer.conftest import toy_pack
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.scenes import photographed
from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.interface.layout import PAGES
from viewer.rendering.offscreen import create_context

SIZE = (640, 400)
KEYS = [imgui.Key.r, imgui.Key.f, imgui.Key.v, imgui.Key.space, imgui.Key.tab, imgui.Key.k, imgui.Key.p, imgui.Key.t,
        imgui.Key.n, imgui.Key.b, imgui.Key.w, imgui.Key.e, imgui.Key._1, imgui.Key._3, imgui.Key.escape, imgui.Key.enter,
        imgui.Key.f1, imgui.Key.home]  # fmt: skip
SAFE = [name for name in COMMANDS if name not in ("quit", "open", "open-folder", "save")]
places = st.tuples(st.floats(0, SIZE[0]), st.floats(0, SIZE[1]))
events = st.one_of(
    st.tuples(st.just("click"), places, st.integers(0, 2)),
    st.tuples(st.just("drag"), places, places, st.integers(0, 2)),
    st.tuples(st.just("wheel"), places, st.floats(-3, 3)),
    st.tuples(st.just("key"), st.sampled_from(KEYS)),
    st.tuples(st.just("page"), st.sampled_from([page.id for page in PAGES] + [""])),
    st.tuples(st.just("resize"), st.integers(480, 700), st.integers(360, 440)),
    st.tuples(st.just("command"), st.sampled_from(SAFE)),
)


@pytest.fixture(scope="module")
def ui(tmp_path_factory, pack, pack_folder):
    known = photographed(pack, tmp_path_factory.mktemp("scene") / "toy")
    ctx = create_context()
    app = App()
    ui = OffscreenUi(ctx, app, size=SIZE)
    app.show(known, pack_folder)
    ui.settle()
    yield ui
    ui.release()
    ctx.release()


def act(ui: OffscreenUi, event: tuple) -> None:
    from viewer.app.commands import run

    match event:
        case ("click", (x, y), button):
            ui.click(x, y, button)
        case ("drag", start, end, button):
            ui.drag([start, end], button)
        case ("wheel", (x, y), notches):
            ui.wheel(notches, x, y)
        case ("key", key):
            ui.key(key)
        case ("page", page):
            ui.app.interface.page = page
        case ("resize", width, height):
            ui.resize(width, height)
        case ("command", name):
            run(ui.app, name)
    ui.frame()


@settings(max_examples=16, deadline=None, phases=[Phase.generate], suppress_health_check=list(HealthCheck))
@given(st.lists(events, min_size=25, max_size=25))
def test_four_hundred_random_events_cause_no_exception_and_no_gl_error(ui, sequence):
    app = ui.app
    if app.scene is None:
        app.show(toy_pack(), Path("toy"))
    ui.resize(*SIZE)
    app.resolution.rest_scale = 0.25
    for event in sequence:
        act(ui, event)
        assert ui.ctx.error == "GL_NO_ERROR"
        app.file_request = None
        app.quitting = False
    for dialog in app.messages.dialogs:  # plain words, never a bug's
        assert "Error" not in dialog.text and "object" not in dialog.text, dialog
    app.messages.dialogs.clear()
