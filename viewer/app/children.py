"""The processes that the program has started and that end with it."""

from __future__ import annotations

from viewer.app.application import App


def end_processes(app: App) -> None:
    """What makes a scene, what exports one, and what holds the clipboard's picture: none outlives the program."""
    app.making.end()
    app.exporting.end()
    app.filming.copied_to.release()
