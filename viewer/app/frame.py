"""Draws one frame's picture, for the window and the offscreen UI: the scene, the comparison, and their figures.

viewer.interface.viewport calls it while it builds the panels, so that picture, comparison and overlays show one camera
and this frame's layout.
"""

from dataclasses import replace

from console import UserError
from viewer.app.application import App
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import RenderSettings
from viewer.rendering.targets import Layer

PHOTOGRAPH = "photograph"


def draw_frame(app: App, canvas: Canvas) -> None:
    """Draws as much as one frame has time for and sets canvas.drawn. A failure opens a dialog."""
    canvas.drawn = None
    try:
        canvas.drawn = _draw(app, canvas)
    except UserError as error:  # e.g. no room for a picture of this size
        app.messages.fail("The picture cannot be drawn", error)
        app.settings = RenderSettings()
        app.comparison.stop()
        canvas.forget()
        app.touch()


def _draw(app: App, canvas: Canvas) -> tuple[float, float | None] | None:
    comparison, settings = app.comparison, app.picture_settings
    if comparison.against == "photograph":  # which has neither
        settings = replace(settings, backdrop=None, look=None)
    scene = app.viewport.camera, settings, app.resolution
    before = unfinished(app, canvas)
    other = _other_pack(app, canvas)
    shown = [canvas] if other is None else [canvas, other]
    drew = [each for each in shown if each.follow(*scene)]
    if drew:  # two pictures that are compared are of one sharpness
        drew += [each for each in shown if each not in drew and each.follow(*scene, anew=True)]
    for each in shown:
        if not drew and each.sharpen(*scene):  # one tile a frame
            drew = [each]
    pair = _compared(app, canvas)
    if comparison.how == "difference" and pair is not None:
        settled = before and not unfinished(app, canvas)  # without drawing: the last tile has appeared
        if drew or settled or canvas.difference is None or app.frames_owed:
            canvas.subtract(*pair, app.viewport.pixels, comparison.gain)
    else:
        canvas.difference = None
    if not drew:
        if not unfinished(app, canvas):
            comparison.measure(app)
            app.costs.measure(app)
        return None
    gpu = [each.gpu_ms for each in drew if each.gpu_ms is not None]
    return sum(each.scene_ms for each in drew), sum(gpu) if gpu else None


def _compared(app: App, canvas: Canvas) -> tuple[Layer, Layer] | None:
    """The picture and what it is compared with. Of two packs, quick pictures are compared until both full ones are done."""
    layers, other = other_layers(app, canvas), _other_pack(app, canvas)
    if not layers or not canvas.layers:
        return None
    if other is not None and unfinished(app, canvas):
        return (canvas.quick, other.quick) if canvas.quick and other.quick else None
    return canvas.layers[0], layers[0]


def _other_pack(app: App, canvas: Canvas) -> Canvas | None:
    """The canvas of the pack that the picture is compared with; None where there is none."""
    return canvas.other if app.comparison.against == "pack" else None


def other_layers(app: App, canvas: Canvas) -> list[Layer]:
    """Layers of what the picture is compared with; empty without a comparison."""
    comparison, other = app.comparison, _other_pack(app, canvas)
    if other is not None:
        return other.layers
    if comparison.against == "photograph" and comparison.pixels is not None:
        texture = canvas.image(PHOTOGRAPH, comparison.pixels)
        return [Layer(texture, (0.0, 0.0), (1.0, 1.0), comparison.box(app))]
    canvas.drop_image(PHOTOGRAPH)
    return []


def unfinished(app: App, canvas: Canvas) -> bool:
    """Whether the picture, or the one compared with, is not yet at full resolution."""
    other = _other_pack(app, canvas)
    return canvas.pending or (other is not None and other.pending)


def is_waiting(app: App) -> bool:
    """Whether a thread works on something that will be shown."""
    thumbnails = app.gallery.thumbnails
    asked_about = app.making.plan is not None and app.making.busy
    preview = app.exporting.preview
    coming = (thumbnails is not None and not thumbnails.finished) or (preview is not None and preview.working)
    return app.loading is not None or asked_about or coming or app.erasing.busy(app)
