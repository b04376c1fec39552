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
    coloured,
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
)
from viewer.features.making import strips_panel
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
        _job_head(app, job, fonts)
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


def _job_head(app: App, job: MakeJob, fonts: Fonts) -> None:
    word = "Stop now" if job.stopping else "Stop"
    width = px(86)
    imgui.align_text_to_frame_padding()
    with font(fonts.bold, 16.0):
        imgui.text_unformatted(job.plan.name)
    if job.figures:
        imgui.same_line(0, px(10))
        with coloured(text=theme.ACCENT):
            imgui.text_unformatted(f"{job.figures[-1]:.1f} dB")
    imgui.same_line()
    imgui.set_cursor_pos_x(imgui.get_window_width() - px(16) - width)
    if imgui.button(word, ImVec2(width, 0)):
        app.making.stop(app)
    tip("Stop without saving" if job.stopping else "Finished work is kept. Make the scene again to continue.")


def _training_preview(app: App) -> None:
    """What is trained so far: shown, or to be shown."""
    making = app.making
    if making.training_preview is None:
        return
    if making.training_preview_shown(app):
        hint(
            f"You see a {making.training_preview.description}. It is small and coarse; a newer one takes its place by itself."
        )
    else:
        if imgui.button(f"{fa.ICON_FA_EYE}  Show the {making.training_preview.description}", ImVec2(-1, px(28))):
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
    imgui.get_window_draw_list().add_image_rounded(
        texture, at, low, ImVec2(0, 0), ImVec2(1, 1), theme.packed("#ffffff"), px(6)
    )
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
            with coloured(text=theme.FAINT):
                imgui.text_unformatted(fa.ICON_FA_CHEVRON_RIGHT)
            imgui.same_line(0, px(8))
        if job.plan.subject == "run" and i == 1:
            with coloured(text=theme.GOOD):
                imgui.text_unformatted(f"{fa.ICON_FA_CHECK}  Trained")
            continue
        done, now = job.stage > i, job.stage == i
        with coloured(text=theme.GOOD if done else theme.TEXT if now else theme.FAINT):
            imgui.text_unformatted(f"{fa.ICON_FA_CHECK}  {name}" if done else name)


def _status_text(job: MakeJob) -> str:
    """How far it is, in words."""
    if job.stopping:
        saving = (
            "Stopping: saving a checkpoint…" if job.plan.stages[max(job.stage, 1) - 1] == "Training" else "Stopping…"
        )
        return "Ending…" if job.child.killed else saving
    report = job.report
    if report is None:
        return (
            "Starting: reading the photographs…"
            if job.plan.bare
            else "Starting: reading the photographs and compiling…"
        )
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
            strips_panel.show_rejected(canvas, review.rejected)
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
        with coloured(text=theme.GOOD):
            imgui.text_unformatted(fa.ICON_FA_CHECK)
        imgui.same_line(0, px(8))
        imgui.text_unformatted(review.plan.name)
    sparse_preview = review.sparse_preview
    hint(
        f"{sparse_preview.photographs} photographs have a camera pose, with {len(sparse_preview.points.places):,} points.",
        theme.MUTED,
    )


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
    label("Box", LABELS)
    on = switch("box", app.settings.crop is not None)
    tip("Show the box that is trained, and drag its faces")
    if on != (app.settings.crop is not None):
        review.show_box(app, on)
        if on:
            app.interface.opens("crop")
    hint(
        "Drag the dots on its faces, or type numbers on the Crop page." if on else "Switch it on to see and change it."
    )


def _upright(app: App, review: Review) -> None:
    """What is up: the cameras' own, or the ground's, which is clicked on."""
    label("Up", LABELS)
    picking = switch("up", review.picking)
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
