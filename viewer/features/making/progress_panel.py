"""Cards of a scene that is being made: how far it is, and the review of its poses before the training."""

from __future__ import annotations

from itertools import pairwise

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from console.progress import duration
from viewer.app.application import App
from viewer.core import theme
from viewer.core.theme import Fonts
from viewer.core.widgets import (
    Box,
    corner_card,
    font,
    half_width,
    hint,
    label,
    main_button,
    px,
    segments,
    switch,
    tip,
    titled_button,
    write,
)
from viewer.features.making import panel
from viewer.features.making.make_job import MakeJob
from viewer.features.making.review import Review
from viewer.rendering.canvas import Canvas

PICTURE = "making"


def show_job(app: App, canvas: Canvas, box: Box, fonts: Fonts) -> None:
    """The card of what is being made, at the lower left of the viewport's box."""
    job = app.making.job
    if job is None:
        canvas.drop_image(PICTURE)
        return
    with corner_card("##job", box):
        note = f"{job.figures[-1]:.1f} dB" if job.figures else ""
        if titled_button(job.plan.name, "Stop now" if job.stopping else "Stop", fonts, note):
            app.making.stop(app)
        tip("Stop without saving" if job.stopping else "Finished work is kept. Make the scene again to continue.")
        if app.making.sparse_preview is not None and not app.making.sparse_preview_shown(app):
            if imgui.button(f"{fa.ICON_FA_EYE}  Show the points and cameras", ImVec2(-1, px(28))):
                app.making.show_points(app)
            tip("The scene that is open now is closed")
        _training_preview(app)
        if job.picture is not None:
            _picture(canvas, job)
        if len(job.figures) > 2:
            _curve(job)
        _stages(job)
        report = job.report
        imgui.progress_bar(report.share if report else 0.0, ImVec2(-1, px(6)), "")
        hint(_status_text(job))


def _training_preview(app: App) -> None:
    """What is trained so far: shown, or to be shown."""
    making = app.making
    if making.training_preview is None:
        return
    name = making.training_preview.description
    if making.training_preview_shown(app):
        hint(f"You see a {name}. It is small and coarse; a newer one takes its place by itself.")
    else:
        if imgui.button(f"{fa.ICON_FA_EYE}  Show the {name}", ImVec2(-1, px(28))):
            making.show_training_preview(app)
        tip("Fly around in what is trained so far")


def _picture(canvas: Canvas, job: MakeJob) -> None:
    """A photograph that is held out, beside how it is rendered so far."""
    assert job.picture is not None
    height, width = job.picture.shape[:2]
    wide = imgui.get_content_region_avail().x
    at = imgui.get_cursor_screen_pos()
    high = wide * height / width
    low = ImVec2(at.x + wide, at.y + high)
    texture = imgui.ImTextureRef(canvas.image(PICTURE, job.picture))
    whole, draw = (ImVec2(0, 0), ImVec2(1, 1)), imgui.get_window_draw_list()
    draw.add_image_rounded(texture, at, low, *whole, theme.packed("#ffffff"), px(6))
    imgui.dummy(ImVec2(wide, high))


def _curve(job: MakeJob) -> None:
    """PSNR since the window began to watch."""
    wide, high = imgui.get_content_region_avail().x, px(34)
    at = imgui.get_cursor_screen_pos()
    imgui.dummy(ImVec2(wide, high))
    low, top = min(job.figures), max(job.figures)
    span, count = max(top - low, 0.5), len(job.figures) - 1
    points = [
        ImVec2(at.x + wide * i / count, at.y + high - px(2) - (value - low) / span * (high - px(4)))
        for i, value in enumerate(job.figures)
    ]
    draw, colour = imgui.get_window_draw_list(), theme.packed(theme.ACCENT)
    for start, end in pairwise(points):
        draw.add_line(start, end, colour, px(1.6))


def _stages(job: MakeJob) -> None:
    for i, name in enumerate(job.plan.stages, 1):
        if i > 1:
            imgui.same_line(0, px(8))
            write(fa.ICON_FA_CHEVRON_RIGHT, theme.FAINT)
            imgui.same_line(0, px(8))
        trained = job.plan.subject == "run" and i == 1
        if trained or job.stage > i:
            write(f"{fa.ICON_FA_CHECK}  {'Trained' if trained else name}", theme.GOOD)
        else:
            write(name, theme.TEXT if job.stage == i else theme.FAINT)


def _status_text(job: MakeJob) -> str:
    """How far it is, in words."""
    if job.stopping:
        training = job.plan.stages[max(job.stage, 1) - 1] == "Training"
        return "Ending…" if job.child.killed else f"Stopping{': saving a checkpoint' if training else ''}…"
    report = job.report
    if report is None:
        return f"Starting: reading the photographs{'' if job.plan.bare else ' and compiling'}…"
    if report.stage == "training":
        parts = [f"Step {report.done:,.0f} of {report.total:,.0f}"]
    else:
        parts = [f"{report.title[:1].upper()}{report.title[1:]}, {100 * report.share:.0f} %"]
    if report.seconds_left is not None and report.share < 1:
        parts.append(f"{duration(report.seconds_left)} left")
    return "   ·   ".join(parts)


# --- Review ---
LABELS = 86.0
KINDS = {"subject": "Subject", "room": "Room", "forward": "Forward"}
ABOUT = {
    "subject": "The cameras look inwards at something. The box keeps to it.",
    "room": "The cameras look outwards. The box reaches to the walls.",
    "forward": "The cameras look one way. All that they see is trained; there is no box.",
}


def show_review(app: App, canvas: Canvas, box: Box, fonts: Fonts) -> None:
    """Draws the card at the lower left of the viewport's box, while there is something to review."""
    review = app.making.review
    if review is None:
        return
    with corner_card("##review", box):
        _head(review, fonts)
        if review.rejected is not None:
            panel.show_rejected(canvas, review.rejected)
        shown = app.making.sparse_preview_shown(app)
        if not shown:
            if imgui.button(f"{fa.ICON_FA_EYE}  Show the points", ImVec2(-1, px(30))):
                review.hold()
                app.making.show_points(app)
            tip("The scene that is open now is closed")
        _choices(app, review, shown)
        _answer(app, review)


def _head(review: Review, fonts: Fonts) -> None:
    with font(fonts.bold, 16.0):
        write(fa.ICON_FA_CHECK, theme.GOOD)
        imgui.same_line(0, px(8))
        imgui.text_unformatted(review.plan.name)
    count, points = review.sparse_preview.photographs, len(review.sparse_preview.points.places)
    hint(f"{count} photographs have a camera pose, with {points:,} points.", theme.MUTED)


def _choices(app: App, review: Review, shown: bool) -> None:
    label("Seen as", LABELS)
    picked = segments("kind", review.kinds, review.kind, KINDS)
    if picked is not None and picked != review.kind:
        app.making.choose_kind(app, picked)  # type: ignore[arg-type]
        if app.settings.crop is not None:
            app.interface.opens("crop")  # where the box is drawn
    hint(ABOUT[review.kind])
    if review.kind == "forward" or not shown:
        return
    _upright(app, review)
    on = switch("box", app.settings.crop is not None, "Box")
    tip("Show the box that is trained, and drag its faces")
    if on != (app.settings.crop is not None):
        review.show_box(app, on)
        if on:
            app.interface.opens("crop")
    usage = "Drag the dots on its faces, or type numbers on the Crop page."
    hint(usage if on else "Switch it on to see and change it.")


def _upright(app: App, review: Review) -> None:
    """What is up: the cameras' own, or the ground's, which is clicked on."""
    picking = switch("up", review.picking, "Up")
    if picking != review.picking:
        review.hold()
        review.picking = picking
    tip("Click on the ground in the picture, and it becomes level")
    if review.picking:
        hint("Click on points of the ground.")
    elif review.plan.up is None:
        hint("From the cameras. Switch it on and click on the ground.")
    else:
        hint("Set by you.")
        imgui.same_line(0, px(12))
        if imgui.small_button("As it was"):
            app.making.set_up(app, None)
        tip("The mean up direction of the cameras")


def _answer(app: App, review: Review) -> None:
    imgui.dummy(ImVec2(0, px(2)))
    half = half_width()
    if imgui.button("Not now", ImVec2(half, px(34))):
        app.making.leave(app)
    tip("The camera poses are kept. Make the scene again to continue.")
    imgui.same_line(0, px(8))
    left = review.seconds_left
    if main_button("Train it" if left is None else f"Train it ({left} s)", half):
        app.making.train(app)
    tip("Training begins by itself if nothing is touched" if left is not None else "Training begins")
