"""One frame's work on the picture, for the window and the offscreen interface: scene, comparison, figures.

It is done while the panels are built (viewer.panels.viewport calls it), so that the picture, what it is compared with,
and what is drawn over it are all of one camera, and lie where this frame's layout has them.
"""

from __future__ import annotations

from dataclasses import replace

from console import UserError
from viewer.app.application import App
from viewer.app.stage import Drawn, Layer, Picture, Stage
from viewer.rendering.settings import RenderSettings

PHOTOGRAPH = "photograph"


def present(app: App, stage: Stage) -> None:
    """Draws as much as one frame has time for, and notes it in stage.drawn. Failures become dialogs."""
    stage.drawn = None
    try:
        stage.drawn = _present(app, stage)
    except UserError as error:  # e.g. no room for a picture of this size
        app.messages.fail("The picture cannot be drawn", error)
        app.settings = RenderSettings()
        app.comparison.stop()
        stage.forget()
        app.touch()


def _present(app: App, stage: Stage) -> Drawn | None:
    settings = app.settings
    if (
        app.comparison.against == "photograph" and settings.backdrop is not None
    ):  # a photograph has the plain background
        settings = replace(settings, backdrop=None)
    comparison, scene = app.comparison, (app.viewport.camera, settings, app.resolution)
    before = unfinished(app, stage)
    shown: list[Picture] = [stage]
    if comparison.against == "pack" and stage.other is not None:
        shown.append(stage.other)
    drew = [each for each in shown if each.follow(*scene)]
    if drew:  # two pictures that are compared are of one sharpness
        drew += [each for each in shown if each not in drew and each.follow(*scene, anew=True)]
    for each in shown:
        if not drew and each.sharpen(*scene):  # one tile a frame
            drew = [each]
    pair = _compared(app, stage)
    if comparison.how == "difference" and pair is not None:
        settled = before and not unfinished(app, stage)  # without drawing: the last tile has appeared
        if drew or settled or stage.difference is None or app.frames_owed:
            stage.subtract(*pair, app.viewport.pixels, comparison.gain)
    else:
        stage.difference = None
    if not drew:
        if not unfinished(app, stage):
            comparison.measure(app)
            app.costs.measure(app)
        return None
    gpu = [each.gpu_ms for each in drew if each.gpu_ms is not None]
    return Drawn(sum(each.scene_ms for each in drew), sum(gpu) if gpu else None)


def _compared(app: App, stage: Stage) -> tuple[Layer, Layer] | None:
    """All of the picture, and all of what it is compared with; two packs are both quick until both are whole."""
    other = other_layers(app, stage)
    if not other or not stage.layers:
        return None
    if app.comparison.against == "pack" and stage.other is not None and unfinished(app, stage):
        return (stage.quick, stage.other.quick) if stage.quick and stage.other.quick else None
    return stage.layers[0], other[0]


def other_layers(app: App, stage: Stage) -> list[Layer]:
    """What the picture is compared with, as layers; none where nothing is."""
    comparison = app.comparison
    if comparison.against == "pack" and stage.other is not None:
        return stage.other.layers
    if comparison.against == "photograph" and comparison.pixels is not None:
        texture = stage.image(PHOTOGRAPH, comparison.pixels)
        return [Layer(texture, (0.0, 0.0), (1.0, 1.0), comparison.box(app))]
    stage.drop_image(PHOTOGRAPH)
    return []


def unfinished(app: App, stage: Stage) -> bool:
    """Whether a picture is not at its full resolution yet."""
    comparing = app.comparison.against == "pack" and stage.other is not None
    return stage.pending or (comparing and stage.other is not None and stage.other.pending)


def awaited(app: App) -> bool:
    """Whether a thread is at work on something that will be seen."""
    thumbnails = app.gallery.thumbnails
    asked_about = app.making.plan is not None and app.making.busy
    preview = app.exporting.preview
    coming = (thumbnails is not None and thumbnails.coming) or (preview is not None and preview.working)
    return app.loading is not None or asked_about or coming
