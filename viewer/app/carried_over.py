"""What the viewer takes over from its last time, and what it remembers for the next one."""

from __future__ import annotations

from dataclasses import replace

from viewer.app.application import App
from viewer.app.backdrops import PLAIN
from viewer.app.preferences import Preferences


def take_over(app: App, preferences: Preferences) -> None:
    """Sets the program up as it was remembered."""
    app.preferences = preferences
    interface = app.interface
    interface.page = preferences.page
    interface.moved, interface.layout = list(preferences.moved), preferences.layout
    interface.theme, interface.scale = preferences.theme, preferences.interface_scale
    interface.axes_shown = preferences.axes_shown
    app.controllers.dead_zone = preferences.dead_zone
    app.settings = replace(app.settings, background=preferences.background, surroundings=preferences.surroundings)
    if preferences.backdrop != PLAIN:
        app.set_backdrop(preferences.backdrop)
    app.resolution.target_fps, app.resolution.enabled = preferences.target_fps, preferences.dynamic_resolution
    app.resolution.rest_scale = preferences.rest_scale


def to_remember(app: App) -> Preferences:
    """The preferences, as the program is set up now."""
    interface, backdrop = app.interface, app.settings.backdrop
    return replace(
        app.preferences,
        page=interface.page,
        moved=list(interface.moved),
        layout=interface.layout,
        background=app.settings.background,
        surroundings=app.settings.surroundings,
        backdrop=backdrop.style if backdrop is not None else PLAIN,
        theme=interface.theme,
        interface_scale=interface.scale,
        axes_shown=interface.axes_shown,
        dead_zone=app.controllers.dead_zone,
        target_fps=app.resolution.target_fps,
        dynamic_resolution=app.resolution.enabled,
        rest_scale=app.resolution.rest_scale,
    )
