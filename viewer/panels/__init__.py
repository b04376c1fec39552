"""The panels: what is drawn over and beside the picture, with Dear ImGui. The only folder that imports imgui_bundle.

Panels draw the state of viewer.app and call its commands; they hold none of their own. `ui.Ui` draws them all.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from imgui_bundle import imgui

from console.streams import printable


def take_any_text() -> None:
    """From now on, functions of imgui that take text take any text of Python's."""
    for place in (imgui, imgui.ImDrawList):
        for name in dir(place):
            function = getattr(place, name)
            takes_text = type(function).__name__ in ("nb_func", "nb_method") and ": str" in (function.__doc__ or "")
            if takes_text and not name.startswith("_"):
                setattr(place, name, _with_any_text(function))


def _with_any_text(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*words: Any, **named: Any) -> Any:
        try:
            return function(*words, **named)
        except TypeError:  # also of text that is not UTF-8
            again = [printable(word) if isinstance(word, str) else word for word in words]
            named_again = {name: printable(word) if isinstance(word, str) else word for name, word in named.items()}
            if again == list(words) and named_again == named:
                raise
            return function(*again, **named_again)

    return call


# Dear ImGui takes UTF-8 only; names of files may be anything.
take_any_text()
