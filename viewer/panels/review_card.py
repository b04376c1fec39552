"""The card between the poses and the training: what was found, what the scene is taken for, its box, and going on."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.review import Review
from viewer.panels import layout, photograph_strips, theme
from viewer.panels.overlays import corner_card
from viewer.panels.theme import Fonts
from viewer.panels.widgets import coloured, font, hint, label, main_button, px, segments, switch, tip
from viewer.rendering.canvas import Canvas

LABELS = 86.0
KINDS = {"subject": "Subject", "room": "Room", "forward": "Forward"}
ABOUT = {
    "subject": "The cameras look inwards at something. The box keeps to it.",
    "room": "The cameras look outwards. The box reaches to the walls.",
    "forward": "The cameras look one way. All that they see is trained; there is no box.",
}


def show(app: App, canvas: Canvas, box: layout.Box, fonts: Fonts) -> None:
    """Draws the card at the lower left of the viewport's box, while there is something to review."""
    review = app.making.review
    if review is None:
        return
    with corner_card("##review", box):
        _head(review, fonts)
        if review.rejected is not None:
            photograph_strips.show_rejected(canvas, review.rejected)
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
    half = (imgui.get_content_region_avail().x - px(8)) / 2
    if imgui.button("Not now", ImVec2(half, px(34))):
        app.making.leave(app)
    tip("The camera poses are kept. Make the scene again to continue.")
    imgui.same_line(0, px(8))
    left = review.seconds_left
    if main_button("Train it" if left is None else f"Train it ({left} s)", half):
        app.making.train(app)
    tip("Training begins by itself if nothing is touched" if left is not None else "Training begins")
