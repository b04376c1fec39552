"""One frame's work on the picture, shared by the window and the offscreen interface: scene, comparison, figures."""

from __future__ import annotations

from console import UserError
from viewer.app.application import App
from viewer.rendering.settings import RenderSettings
from viewer.window.canvas import Canvas, Layer

PHOTOGRAPH = "photograph"


def present(app: App, canvas: Canvas, *, wait: bool = True) -> bool:
    """Draws as much as this frame has time for; True where anything was drawn. Failures become dialogs."""
    try:
        return _present(app, canvas, wait)
    except UserError as error:  # e.g. no room for a picture of this size
        app.messages.fail("The picture cannot be drawn", error)
        app.settings = RenderSettings()
        app.comparison.stop()
        canvas.forget()
        return True


def _present(app: App, canvas: Canvas, wait: bool) -> bool:
    camera, comparison = app.camera(), app.comparison
    drawn = canvas.draw(camera, app.settings, app.governor, wait)
    pending = canvas.pending
    if comparison.against == "pack" and canvas.other is not None:
        if not drawn or canvas.other.renderer is None or not pending:
            drawn = canvas.other.draw(camera, app.settings, app.governor, wait) or drawn
        pending = pending or canvas.other.pending
    other = other_layers(app, canvas)
    if comparison.how == "difference" and other:
        if drawn or canvas.difference is None or app.frames_owed:
            canvas.subtract(other[0], app.viewport.pixels, comparison.gain)
    else:
        canvas.difference = None
    if not pending and not drawn:
        comparison.measure(app)
        app.costs.measure(app)
    return drawn


def other_layers(app: App, canvas: Canvas) -> list[Layer]:
    """What the picture is compared with, as layers; none where nothing is."""
    comparison = app.comparison
    if comparison.against == "pack" and canvas.other is not None:
        return canvas.other.layers
    if comparison.against == "photograph" and comparison.pixels is not None:
        texture = canvas.image(PHOTOGRAPH, comparison.pixels)
        return [Layer(texture, (0.0, 0.0), (1.0, 1.0), comparison.box(app))]
    canvas.drop_image(PHOTOGRAPH)
    return []


def unfinished(app: App, canvas: Canvas) -> bool:
    """Whether a picture is not at its full resolution yet."""
    comparing = app.comparison.against == "pack" and canvas.other is not None
    return canvas.pending or (comparing and canvas.other is not None and canvas.other.pending)


def awaited(app: App) -> bool:
    """Whether a thread is at work on something that will be seen."""
    thumbnails = app.comparison.thumbnails
    asked_about = app.making.plan is not None and app.making.busy
    return app.loading is not None or asked_about or (thumbnails is not None and thumbnails.coming)
