"""Pages are dragged out of their place, docked elsewhere, remembered, and brought back."""

import pytest

from viewer.app.application import App
from viewer.features.preferences import preferences
from viewer.features.preferences.preferences import apply_preferences, current_preferences


@pytest.fixture
def ui(offscreen, app, pack, pack_folder):
    return offscreen(app, pack, pack_folder)


def pull_out(ui, to: tuple[float, float] = (300.0, 200.0)) -> None:
    """Drags the tab of the page at the usual place into the picture."""
    ui.pull((ui.app.viewport.width + 60, 62.0), to, 12)


def test_a_page_is_pulled_out_another_takes_its_place_and_the_rail_opens_it_again(ui, app):
    usual = app.viewport.width
    pull_out(ui)
    assert app.interface.moved == ["view"] and app.interface.page == ""
    assert app.viewport.width > usual + 250  # the picture has the place
    app.interface.opens("camera")
    ui.settle()
    assert app.interface.page == "camera" and app.viewport.width == usual
    app.interface.opens("film")
    ui.settle()
    assert app.interface.moved == ["view"] and app.interface.page == "film" and ui.ctx.error == "GL_NO_ERROR"
    app.interface.closes("view")
    ui.settle()
    assert not app.interface.shows("view")
    app.interface.opens("view")
    ui.settle()
    assert app.interface.moved == ["view"]  # where it was left


def test_a_layout_is_remembered_comes_back_and_is_reset(ui, app, offscreen, tmp_path, pack, pack_folder):
    usual = app.viewport
    pull_out(ui)
    ui.pull((300.0, 200.0), (24.0, app.viewport.y + app.viewport.height / 2), 12)
    app.interface.opens("film")
    ui.settle()
    app.interface.layout = ui.ui.layout
    file = tmp_path / "viewer.json"
    assert preferences.save(current_preferences(app), file) is None
    again = App()
    apply_preferences(again, preferences.load(file))
    offscreen(again, pack, pack_folder)
    assert again.interface.moved == ["view"] and again.interface.page == "film"
    assert again.viewport.x == app.viewport.x > 200 and again.viewport.width == app.viewport.width
    assert app.run("layout")
    ui.settle()
    assert app.interface.moved == [] and app.interface.page == "film" and app.viewport == usual
