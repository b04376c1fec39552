"""The pages with lists of views: each has its picture, drawn one a frame, and what is clicked is gone to."""

from __future__ import annotations

import numpy as np
import pytest

from tests.viewer.window.widgets_seen import watch
from viewer.app.commands import run
from viewer.features.bookmarks.bookmarks import SIZE


@pytest.fixture
def ui(offscreen, app, pack, pack_folder):
    ui = offscreen(app, size=(900, 640))
    app.resolution.rest_scale = 0.25
    app.show(pack, pack_folder)
    app.interface.page = ""
    ui.settle()
    for turn in (0.0, 0.3, 0.3, 0.3):
        app.scene.rig.orbit(turn, 0.0)
        app.scene.rig.shown = app.scene.rig.goal
        run(app, "bookmark")
    ui.settle()
    return ui


def rows_of(ui, page: str, name: str) -> list[tuple[float, float, float, float]]:
    ui.app.interface.page = page
    with watch() as seen:
        ui.settle()
        rows = {label: each.rect for (_, label), each in seen.seen.items() if label.startswith(f"##{name}")}
    return [rows[label] for label in sorted(rows)]


def thumbnail(ui, rect: tuple[float, float, float, float]) -> np.ndarray:
    x0, y0, _, y1 = rect
    return ui.picture()[round(y0) + 6 : round(y1) - 6, round(x0) + 10 : round(x0) + 64].astype(float)


def test_each_view_has_its_own_picture(ui, app):
    rows = rows_of(ui, "bookmarks", "bookmark")
    assert len(rows) == 4
    pictures = [thumbnail(ui, rect) for rect in rows]
    for picture in pictures:
        assert picture.std(axis=(0, 1)).max() > 20  # something of the toy
    assert all(np.abs(a - b).max() > 60 for i, a in enumerate(pictures) for b in pictures[:i])
    expected = app.views._pictures
    assert len(expected) == 4 and all(picture.shape == (SIZE[1], SIZE[0], 3) for picture in expected.values())


def test_a_click_on_a_row_goes_there(ui, app):
    rows = rows_of(ui, "bookmarks", "bookmark")
    x0, y0, x1, y1 = rows[1]
    ui.click(0.5 * (x0 + x1), 0.5 * (y0 + y1))
    ui.settle()
    view = app.annotations.current.bookmarks[1]
    assert app.bookmarks.selected == 1
    assert np.allclose(app.scene.rig.matrix[:3, 3], view.eye, atol=1e-3)
