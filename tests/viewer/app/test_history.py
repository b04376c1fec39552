"""One history: whatever was changed last is undone first, and nothing else."""

from dataclasses import replace
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from tests.viewer.conftest import toy_pack
from viewer.app.application import App
from viewer.core.annotations import Bookmark
from viewer.core.pose import DEPTH, History
from viewer.features.placing import placing

PACK = toy_pack()
STEPS = st.lists(st.sampled_from(["orbit", "crop", "near", "home", "move", "mark", "nothing"]), min_size=1, max_size=12)


def state(app: App) -> tuple:
    rig, annotations = app.open_scene.rig, app.annotations.current
    assert rig.table.placed == annotations.placement.rotation
    return rig.goal, rig.table, annotations, app.settings.crop, app.settings.near


@given(STEPS)
def test_moves_cuts_marks_and_the_near_plane_are_undone_in_turn(steps):
    app = App()
    app.show(PACK, Path("toy"))
    states = [state(app)]
    for i, step in enumerate(steps):
        if step == "orbit":
            app.open_scene.rig.remember()
            app.open_scene.rig.orbit(0.01 * (i + 1), 0.0)
        elif step == "crop":
            app.cut(crop=((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5 + 0.01 * i)))
        elif step == "near":
            app.cut(near=0.1 * (i + 1))
        elif step == "move":
            placing.change(app, app.annotations.current.placement.with_angles(20.0 + i, 10.0, 0.0))
        elif step == "mark":
            mark = Bookmark(f"{i}", (0.0, 1.0, 4.0), (0.0, 0.0, 0.0))
            app.annotations.change(app, replace(app.annotations.current, bookmarks=(mark,)))
        elif step == "home":
            app.run("home")
        else:
            app.open_scene.rig.remember()
        if state(app) != states[-1]:
            states.append(state(app))
    for expected in reversed(states[:-1]):
        app.run("undo")
        assert state(app) == expected
    assert not app.open_scene.rig.history.undo()
    for expected in states[1:]:
        app.run("redo")
        assert state(app) == expected
    assert not app.open_scene.rig.history.redo()


def test_a_history_is_bounded_and_forgets_what_was_undone_after_something_new():
    value = [0]
    history = History()
    history.follow(lambda: value[0], lambda old: value.__setitem__(0, old))
    for i in range(2 * DEPTH):
        history.remember()
        value[0] = i + 1
    assert history.undo() and value[0] == 2 * DEPTH - 1
    history.remember()
    value[0] = -1
    assert not history.redo()
    count = 0
    while history.undo():
        count += 1
    assert count <= DEPTH
