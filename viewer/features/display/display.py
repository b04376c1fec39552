"""Display modes of the open pack, and what is behind it.

The plain background goes through the view MLP, which knows only the one that it was trained with; a backdrop does not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from viewer.rendering.settings import MODES, Backdrop, Look

if TYPE_CHECKING:
    from viewer.app.application import App

BACKGROUNDS: dict[str, tuple[float, float, float]] = {
    "White": (1.0, 1.0, 1.0),
    "Light": (0.82, 0.85, 0.89),
    "Dark": (0.09, 0.11, 0.14),
    "Black": (0.0, 0.0, 0.0),
}
PLAIN = "plain"
TRAINED = (1.0, 1.0, 1.0)  # the background that packs are trained with, which a pack does not say
GREYS: dict[tuple[str, str], tuple[float, float]] = {  # above and below, or of the squares
    ("gradient", "dark"): (0.58, 0.38),
    ("gradient", "light"): (0.95, 0.74),
    ("checker", "dark"): (0.46, 0.38),
    ("checker", "light"): (0.86, 0.74),
}
TINT = (0.94, 1.0, 1.07)  # a little blue, as the panels are


def backdrop(style: str, theme: str) -> Backdrop | None:
    """The backdrop of a style in a theme; None for a plain background, and for what is not known."""
    greys = GREYS.get((style, theme)) or GREYS.get((style, "dark"))
    if greys is None:
        return None
    first, second = (tuple(min(grey * tint, 1.0) for tint in TINT) for grey in greys)
    return Backdrop("checker" if style == "checker" else "gradient", first, second)  # type: ignore[arg-type]


def set_look(app: App, **changes: float) -> None:
    """Changes the look; remember() beforehand."""
    annotations = app.annotations.current
    look = replace(annotations.look or Look(), **changes)
    app.annotations.current = replace(annotations, look=None if look == Look() else look)
    app.touch()


def modes_for(app: App) -> tuple[str, ...]:
    if app.scene is not None and app.scene.pack.view_mlp is None:
        return tuple(mode for mode in MODES if mode not in ("features", "view-dependent"))
    return MODES


def next_mode(app: App, step: int) -> None:
    """Shows the mode that is `step` further in that list."""
    modes = modes_for(app)
    now = modes.index(app.settings.mode) if app.settings.mode in modes else 0
    app.set(mode=modes[(now + step) % len(modes)])
