"""Settings are saved when they change, away from the loop; a failure is told once; other viewers' packs are kept."""

import json
import threading
import time
from pathlib import Path

import pytest

from tests.viewer.waiting import until
from viewer.app.application import App
from viewer.features.preferences import preferences
from viewer.features.preferences.preferences import PreferencesAutosave, apply_preferences, load, save


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "snerg" / "viewer.json"


@pytest.fixture
def autosave(file: Path, monkeypatch: pytest.MonkeyPatch) -> PreferencesAutosave:
    monkeypatch.setattr(preferences, "SETTLE_S", 0.0)
    return PreferencesAutosave(App(), file, lambda: (640, 480), lambda: "a layout")


def test_a_change_is_saved_by_a_thread_once_it_has_stayed_for_a_look(autosave, file, monkeypatch):
    threads = []
    monkeypatch.setattr(preferences, "save", lambda *words: threads.append(threading.current_thread()) or save(*words))
    autosave.app.interface.page = "film"
    autosave.poll()  # sees it for the first time
    assert not file.exists()
    until(lambda: autosave.poll() or file.exists())
    assert load(file).items() >= {"page": "film", "window": [640, 480], "layout": "a layout"}.items()
    assert threads and threading.main_thread() not in threads
    until(lambda: autosave.poll() or not autosave._autosave.writing)
    count = len(threads)
    for _ in range(5):
        autosave.poll()
    assert len(threads) == count  # nothing changed since


def test_a_failure_is_told_once_and_the_next_change_is_tried_again(autosave, file):
    file.parent.write_text("in the way")
    app = autosave.app
    app.interface.page = "film"
    until(lambda: autosave.poll() or app.messages.toast)
    assert "not saved" in app.messages.toast and len(app.messages.lines) == 1 and not app.messages.dialogs
    app.interface.page = "crop"
    for _ in range(20):
        autosave.poll()
        time.sleep(0.01)
    assert len(app.messages.lines) == 1 and autosave.finish() is None
    file.parent.unlink()
    app.interface.page = "log"
    until(lambda: autosave.poll() or file.exists())
    assert load(file)["page"] == "log"


def test_two_viewers_write_only_what_changed_in_each_and_unknown_keys_stay(autosave, file):
    autosave.app.preferences.recent, autosave.app.walking.eye_height_m = ["/b"], 1.2
    assert autosave.finish() is None
    file.write_text(json.dumps({**load(file), "from a newer version": 3}))
    other = App()
    apply_preferences(other, load(file))
    assert other.walking.eye_height_m == 1.2
    second = PreferencesAutosave(other, file, lambda: (640, 480), lambda: "a layout")
    autosave.app.interface.page, autosave.app.preferences.recent = "film", ["/c", "/b"]
    other.resolution.target_fps, other.preferences.recent = 60.0, ["/d", "/b"]
    assert autosave.finish() is None and second.finish() is None
    found = load(file)
    assert (found["page"], found["target_fps"], found["recent"]) == ("film", 60.0, ["/d", "/c", "/b"])
    assert found["from a newer version"] == 3
