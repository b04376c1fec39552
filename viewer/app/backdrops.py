"""What stands behind a scene on the screen, by name: gradients and checkerboards that go with the theme.

The plain background goes through the view MLP, which knows only the one that it was trained with; a backdrop does not.
"""

from __future__ import annotations

from viewer.rendering.settings import Backdrop

PLAIN = "plain"
STYLES = ("gradient", "checker")
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
