"""Names of files that are not UTF-8 are drawn like others."""

from __future__ import annotations

from pathlib import Path

import pytest
from imgui_bundle import imgui

NAME = "n\udcffme"


def test_a_pack_a_photograph_and_a_message_may_have_any_name(offscreen, app, pack, pack_folder: Path) -> None:
    ui = offscreen(app)
    app.preferences.recent = [str(pack_folder.with_name(NAME))]
    pack_folder.with_name(NAME).mkdir()
    ui.frame()  # the start page lists it
    app.show(pack, pack_folder.with_name(NAME))
    for page in ("view", "photographs", "bookmarks", "log"):
        app.interface.page = page
        app.messages.say(f"Saved {NAME}")
        ui.frame()
    app.messages.fail(NAME, f"{NAME} was not written")
    ui.settle()


def test_what_is_wrong_otherwise_is_still_told(offscreen, app) -> None:
    offscreen(app)
    with pytest.raises(TypeError):
        imgui.text(3)  # type: ignore[arg-type]
    with pytest.raises(TypeError):
        imgui.selectable(NAME, "no truth")  # type: ignore[arg-type]
