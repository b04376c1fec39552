"""What the interface shows, on disk, and what stands in for work of minutes."""

import threading
from collections.abc import Iterator

import pytest

from scenepack import save_pack
from tests.viewer.conftest import toy_pack
from tests.viewer.interface.places import Scenes, child
from tests.viewer.scenes import photographed
from tests.viewer.waiting import not_none, until
from viewer.core import tasks
from viewer.features.making import make_plan, making, survey
from viewer.features.making.make_plan import Plan
from viewer.features.making.survey import Survey
from viewer.features.opening import opening


@pytest.fixture(scope="module")
def scenes(tmp_path_factory) -> Iterator[Scenes]:
    """What is opened; whatever would start a program, or take its time, stands still."""
    folder = tmp_path_factory.mktemp("clicks")
    pack = photographed(toy_pack(), folder / "scene", 4)
    (folder / "scene" / "masks").mkdir()  # there is one more thing to choose
    save_pack(pack, folder / "toy")
    plan = Plan("scene", folder / "scene", folder / "scene-snerg", survey=Survey(folder / "scene"))
    survey_read = not_none(plan.survey)
    until(lambda: survey_read.finished)
    survey_read.forward = True
    release, read = threading.Event(), opening.load_pack
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(making, "CommandProcess", lambda *_: child())
        patch.setattr(tasks, "CommandProcess", lambda *_: child())
        patch.setattr(survey.webbrowser, "open", lambda address: True)
        patch.setattr(make_plan, "trainer_missing", lambda: False)
        patch.setattr(opening, "load_pack", lambda path, **options: (release.wait(60), read(path, **options))[1])
        yield Scenes(pack, toy_pack(seed=1), folder / "toy", folder / "scene", plan, release)
        release.set()
