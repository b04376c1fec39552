"""snerg.show: the page in a notebook's cell, a picture where the page is refused, and one line where there is no display."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import snerg
from console import UserError


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """What a notebook's cell shows, in a notebook that is made up."""
    shown: list[object] = []
    ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
    ipython.get_ipython = lambda: SimpleNamespace(config={"IPKernelApp": {}})  # type: ignore[attr-defined]
    display.display, display.HTML = shown.append, lambda text: ("html", text)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    return shown


def test_a_cell_shows_the_page_in_a_frame(toy: Path, cell: list) -> None:
    snerg.show(snerg.load(toy), size=(320, 200))
    ((kind, text),) = cell
    assert kind == "html" and text.startswith("<iframe srcdoc=") and 'width="320" height="200"' in text
    assert "<script" not in text  # it is text of an attribute


def test_a_cell_shows_a_picture_where_there_can_be_no_page(
    toy: Path, cell: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> bytes:
        raise UserError("the pack is too large for a web page")

    monkeypatch.setattr("viewer.web.page.scene_page", refuse)
    with snerg.load(toy) as scene:
        snerg.show(scene, size=(64, 40))
    assert [picture.size for picture in cell] == [(64, 40)]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems always have a display")
def test_without_a_display_it_says_what_to_do(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(snerg.SnergError, match=r"scene\.render\(\)"):
        snerg.show(snerg.load(toy))
