"""UI interface required by Window; implemented by viewer.panels.ui.Ui, which the command passes in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.app.keyboard import Keyboard, KeyPress
from viewer.app.state import Clipboard


class UiInterface(Protocol):
    """All panels of one window. The window's OpenGL context must be current."""

    keyboard: Keyboard  # receives keys that go down and up
    scale: float  # size of the panels, 1 is usual; 0 before the first frame

    @property
    def clipboard(self) -> Clipboard:
        """The system's."""
        ...

    @property
    def background(self) -> tuple[float, float, float]:
        """The colour behind all, red, green, blue in 0 … 1."""
        ...

    def pressed(self, press: KeyPress) -> None:
        """A key or a character."""

    def modifier_changes(self) -> None:
        """Ctrl, Shift, Alt or Cmd goes down or up."""

    def frame(self, app: App, canvas: CanvasInterface, scale: float = 1.0) -> None:
        """Builds the panels for the present state, with the picture of `canvas`, and passes the user's input to `app`."""

    def draw(self) -> None:
        """Draws what `frame` prepared into the framebuffer that is bound."""

    @property
    def layout(self) -> str:
        """Where the pages are docked, for the preferences."""
        ...

    @property
    def typing(self) -> bool:
        """Whether a text field has the keyboard, so that frames must be drawn for its cursor."""
        ...

    @property
    def hears(self) -> bool:
        """Whether there is input that no frame has seen."""
        ...

    @property
    def fonts_coming(self) -> bool:
        """Whether there may be more letters soon."""
        ...

    def release(self) -> None:
        """Frees textures and fonts."""


MakeUi = Callable[[int], UiInterface]  # from the address of a GLFW window, whose events they listen to
