"""What making a scene takes on this computer: measured by the real program, told in the dialog, given up with it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from tests.viewer.waiting import until
from tools.procedural import write_procedural_scene
from viewer.features.making import survey as survey_module
from viewer.features.making.panel import what_it_needs
from viewer.features.making.survey import Survey


@pytest.mark.slow
def test_time_and_disk_are_measured_here_for_each_size_and_preset_of_voxels(tmp_path, monkeypatch):
    monkeypatch.setattr(survey_module, "MEASURES", True)
    survey = Survey(write_procedural_scene(tmp_path / "scene", size=32, views=4, subpixels=1))
    until(lambda: survey.finished)
    needed = survey.time
    assert needed is not None
    needed.result()  # a busy machine takes longer than other tests wait
    assert not survey.busy and survey.news() and not survey.news()
    seconds = needed.seconds("quick", 32)
    assert seconds is not None and 1.0 < seconds < 1e6
    assert needed.seconds("full", 32) == pytest.approx(18 / 5 * seconds)
    assert needed.seconds("paper", 32) is None and needed.disk("paper", 32) is None
    disk = needed.disk("quick", 32)
    assert disk is not None and 1e8 < disk < 1e9
    survey.close()


@pytest.mark.parametrize(
    ("seconds", "finished", "told"),
    [
        (None, False, "Measuring how long it takes on this computer… It needs up to 2.9 GB"),
        (None, True, "It needs up to 2.9 GB of memory and 0.5 GB on the disk."),
        (437.0, True, "Takes about 7 min as measured on this computer, up to 2.9 GB"),
    ],
)
def test_the_dialog_says_what_is_known(seconds, finished, told):
    known = SimpleNamespace(seconds=lambda *_: seconds, disk=lambda *_: 0.51e9, finished=finished)
    assert what_it_needs(SimpleNamespace(preset="quick", survey=SimpleNamespace(time=known)), 200).startswith(told)
    assert what_it_needs(SimpleNamespace(preset="quick", survey=SimpleNamespace(time=None)), 200) == ""
