"""The keyboard as the viewer knows it: presses that wait for their turn, and the keys that are held.

Notation: a key's place is what is printed there on a US keyboard ("W", "Home", "Left"), whatever the user's layout; its
name is the letter or digit that the layout gives it ("Z" on a French keyboard at the place "W"), else its place.
Commands go by names and characters, as on any desktop; what a hand rests on (flying) goes by places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

FLYING = ("W", "A", "S", "D", "Q", "E")  # places: forward, left, back, right, down, up


@dataclass(frozen=True)
class KeyPress:
    """A key that went down, with the modifiers of that very moment; or a character that was typed, with name "".

    ctrl: Cmd on macOS. repeat: the system repeats a key that is held.
    """

    name: str = ""
    ctrl: bool = False
    shift: bool = False
    alt: bool = False
    repeat: bool = False
    character: str = ""


@dataclass
class Keyboard:
    """held: places of the keys that are down. local_name: what the user's layout prints at a place."""

    held: set[str] = field(default_factory=set)
    local_name: Callable[[str], str] = lambda place: place
    _tapped: set[str] = field(default_factory=set)  # went down since the last frame, and perhaps up again

    def down(self, place: str) -> None:
        """A key went down."""
        self.held.add(place)
        self._tapped.add(place)

    def up(self, place: str) -> None:
        """A key went up."""
        self.held.discard(place)

    def leave(self) -> None:
        """The window has lost the keyboard: nothing is held any more."""
        self.held, self._tapped = set(), set()

    def axis(self, plus: str, minus: str) -> float:
        """1, 0 or -1: which of two keys is held, or was tapped since the last frame."""
        active = self.held | self._tapped
        return float(plus in active) - float(minus in active)

    def seen(self) -> None:
        """A frame has seen what was tapped."""
        self._tapped.clear()

    @property
    def flying_names(self) -> tuple[str, ...]:
        """What the user's layout prints on the keys of FLYING."""
        return tuple(self.local_name(place) for place in FLYING)
