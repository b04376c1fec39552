"""What can be pressed on the screen: every widget of Dear ImGui that the panels draw, as they draw it.

`watch` wraps imgui's own functions, which all panels call through the module, so that a button that somebody adds tomorrow
is seen as well. Nothing is pressed here, and no widget behaves otherwise.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from imgui_bundle import imgui

from viewer.interface.layout import HOST

Rect = tuple[float, float, float, float]  # x0, y0, x1, y1 in window units

BUTTONS = ("button", "small_button", "arrow_button", "invisible_button", "image_button", "checkbox", "radio_button")
LINES = ("selectable", "menu_item")
FIELDS = (
    "slider_float", "slider_int", "slider_float2", "slider_float3", "drag_float", "drag_int", "input_text",
    "input_text_with_hint", "input_text_multiline", "input_int", "input_int2", "input_float", "color_edit3", "color_edit4",
    "color_button", "collapsing_header", "tree_node",
)  # fmt: skip
# Other functions that take clicks; the panels may use them once they are wrapped here.
UNKNOWN = ("begin_menu", "begin_tab_item", "tab_item_button", "list_box", "combo", "v_slider_float", "image_with_bg")


@dataclass(frozen=True)
class Seen:
    """A widget in one frame. window, label: of imgui. at: where a person would click it. pressed: it said so itself.

    rect: all of it. clip: the part of the screen that its window may draw on. scrolling: the windows around it that can be
    scrolled, the outermost first: their visible parts.
    """

    window: str
    label: str
    kind: str
    rect: Rect
    clip: Rect
    scrolling: tuple[Rect, ...]
    disabled: bool
    pressed: bool
    focused: bool = False  # by the keyboard
    modal: bool = False  # of a dialog that keeps everything else waiting

    @property
    def at(self) -> tuple[float, float]:
        """Not the middle: fields of several numbers have a gap there."""
        x0, y0, x1, y1 = self.rect
        return x0 + 0.3 * (x1 - x0), 0.5 * (y0 + y1)

    @property
    def in_view(self) -> bool:
        """Whether that point is drawn, with a little of what is around it."""
        return inside(self.at, self.clip, 2.0)


def inside(point: tuple[float, float], rect: Rect, margin: float = 0.0) -> bool:
    x0, y0, x1, y1 = rect
    return x0 + margin <= point[0] <= x1 - margin and y0 + margin <= point[1] <= y1 - margin


class Watch:
    """seen: the widgets of the frame that was drawn last, and of the one that is being drawn."""

    def __init__(self) -> None:
        self.seen: dict[tuple[str, str], Seen] = {}
        self.pressed: set[tuple[str, str]] = set()  # until somebody clears it
        self._drawing: dict[tuple[str, str], Seen] = {}

    def note(self, kind: str, label: str, rect: Rect, pressed: bool) -> None:
        window = imgui.internal.get_current_window_read()
        name = _plain(window.name), label
        flags = imgui.get_current_context().current_item_flags  # not the last item's: it may be another
        disabled = bool(flags & imgui.ItemFlags_.disabled)
        clip, scrolling = _rect(window.clip_rect), []
        around: Any = window
        while around is not None and not around.name.startswith(HOST):
            if around.scroll_max.y > 0:
                scrolling.append(_rect(around.inner_clip_rect))
            around = around.parent_window
        focused = imgui.is_item_active() or (imgui.is_item_focused() and imgui.get_io().nav_visible)
        modal = bool(window.root_window.flags & imgui.WindowFlags_.modal)
        seen = Seen(*name, kind, rect, clip, tuple(reversed(scrolling)), disabled, pressed, focused, modal)
        self._drawing[name] = seen
        if pressed:
            self.pressed.add(name)


def _plain(window: str) -> str:
    """A child's name without the number that imgui gives it."""
    return window.rsplit("_", 1)[0] if "/" in window else window


def _rect(rect: Any) -> Rect:
    return rect.min.x, rect.min.y, rect.max.x, rect.max.y


def _last_item() -> Rect:
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    return low.x, low.y, high.x, high.y


@contextmanager
def watch() -> Iterator[Watch]:
    """Wraps imgui's widgets until the `with` block ends."""
    seen = Watch()

    def wrap(name: str, around: Callable[..., Any]) -> None:
        original = getattr(imgui, name)
        patch.setattr(imgui, name, lambda *words, **named: around(name, original, *words, **named))

    def button(name: str, original: Callable, label: str, *words: Any, **named: Any) -> Any:
        result = original(label, *words, **named)
        seen.note(name, label, _last_item(), result[0] if isinstance(result, tuple) else bool(result))
        return result

    def field(name: str, original: Callable, label: str, *words: Any, **named: Any) -> Any:
        result = original(label, *words, **named)
        seen.note(name, label, _last_item(), imgui.is_item_activated() or imgui.is_item_clicked())
        return result

    def combo(name: str, original: Callable, label: str, *words: Any, **named: Any) -> bool:
        corner, width, height = imgui.get_cursor_screen_pos(), imgui.calc_item_width(), imgui.get_frame_height()
        rect = corner.x, corner.y, corner.x + width, corner.y + height
        window = imgui.internal.get_current_window_read()
        opened = original(label, *words, **named)
        if opened:  # the list is the window that is drawn now
            at = _plain(window.name), label
            seen._drawing[at] = Seen(*at, name, rect, _rect(window.clip_rect), (), False, True)
            seen.pressed.add(at)
        else:
            seen.note(name, label, rect, False)
        return opened

    def begin(_: str, original: Callable, window: str, is_open: bool | None = None, *words: Any, **named: Any) -> Any:
        result = original(window, is_open, *words, **named)
        if is_open is not None:  # a title bar or a tab with a cross at its right end
            x0, y0, x1, y1 = _last_item()
            side, padding = imgui.get_font_size(), imgui.get_style().frame_padding
            cross = x1 - padding.x - side, y0 + padding.y, x1 - padding.x, y0 + padding.y + side
            here = f"{window} ×"
            seen._drawing[here, here] = Seen(here, here, "cross", cross, (x0, y0, x1, y1), (), False, not result[1])
            if not result[1]:
                seen.pressed.add((here, here))
        return result

    def new_frame(_: str, original: Callable) -> None:
        original()
        seen._drawing = {}

    def render(_: str, original: Callable) -> None:
        original()
        seen.seen = seen._drawing

    def refuse(name: str, original: Callable, *words: Any, **named: Any) -> Any:
        pytest.fail(f"the click test does not know imgui.{name}: wrap it in {__name__}")

    with pytest.MonkeyPatch.context() as patch:
        for names, around in (
            (BUTTONS + LINES, button),
            (FIELDS, field),
            (("begin_combo",), combo),
            (("begin",), begin),
            (("new_frame",), new_frame),
            (("render",), render),
            (UNKNOWN, refuse),
        ):
            for name in names:
                if hasattr(imgui, name):
                    wrap(name, around)
        yield seen
