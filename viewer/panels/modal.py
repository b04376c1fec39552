"""Which dialog is in front: one at a time. Two modal windows at once would push each other away in every frame, and no key and
no click would reach either.
"""

from __future__ import annotations

from typing import Literal

from viewer.app.application import App

Modal = Literal["", "message", "path", "open", "make", "export"]


def in_front(app: App) -> Modal:
    """What waits for an answer, and comes first of all that does; "" where nothing does."""
    if app.messages.dialogs:
        return "message"
    if app.file_request is not None:
        return "path"
    if app.open_prompt is not None:
        return "open"
    if app.making.plan is not None:
        return "make"
    return "export" if app.exporting.asking else ""
