"""What a feature may ask of the program around it.

Features (comparison, photographs, film, ray costs, making, opening) take a host and never the whole App, so that nothing
imports in a circle: application.py imports them, and they import this. One that needs more says so in its own module,
with a protocol that adds to one of these.
"""

from __future__ import annotations

from typing import Protocol

from viewer.app.log import Messages
from viewer.app.stage import Stage
from viewer.app.state import FRAMES_AFTER_EVENT, OpenScene, Viewport
from viewer.rendering.camera import ViewCamera
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.settings import RenderSettings


class Teller(Protocol):
    """Somewhere to say what happens."""

    messages: Messages

    def touch(self, frames: int = FRAMES_AFTER_EVENT) -> None:
        """Something changed: the next frames must be drawn."""


class Host(Teller, Protocol):
    """What is shown, and how. stage: None where there is no window. scene: None while nothing is open."""

    stage: Stage | None
    scene: OpenScene | None
    settings: RenderSettings
    resolution: DynamicResolution
    viewport: Viewport

    def camera(self) -> ViewCamera | None:
        """The camera of this moment, for the whole viewport at full resolution."""
        ...

    @property
    def fov(self) -> float:
        """Vertical field of view of what is shown, degrees."""
        ...
