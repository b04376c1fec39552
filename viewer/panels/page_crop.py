"""Cutting the scene: a box that is dragged, and the near plane."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from scenepack.pack import Pack
from viewer.app import crop
from viewer.app.application import App
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, hint, label, segments, switch
from viewer.window.canvas import Canvas

TITLES = {"faces": "Faces", "move": "Move", "scale": "Scale"}
HINTS = {
    "faces": "Drag the dots on the box's faces in the picture.",
    "move": "Drag the arrows in the picture, or the squares between them.",
    "scale": "Drag the knobs in the picture to scale about the middle.",
}


def show(app: App, canvas: Canvas, fonts: Fonts) -> None:
    """Draws the page."""
    if app.scene is None:
        return
    pack, rig = app.scene.pack, app.scene.rig
    if rig.bounded:
        with card("none", fonts, "Crop box"):
            hint("Forward-facing packs live in a warped space, where a box would not look like one.")
        return
    with card("crop", fonts, "Crop box"):
        label("Cut to a box")
        on = switch("crop", app.settings.crop is not None)
        if on != (app.settings.crop is not None):
            _cut(app, crop.whole(pack) if on else None)
        if app.settings.crop is None:
            hint("Nothing is cut off.")
        else:
            picked = segments("tool", crop.TOOLS, app.crop.tool, TITLES)
            if picked in crop.TOOLS:
                app.crop.tool = picked
                app.touch()
            hint(HINTS[app.crop.tool])
            _faces(app, pack)
            if imgui.button("Whole scene again", ImVec2(-1, 0)):
                _cut(app, crop.whole(pack))
    with card("near", fonts, "Slice"):
        label("Near plane")
        changed, value = imgui.slider_float("##near slice", app.settings.near, 0.0, 3.0 * rig.radius, "%.3f")
        if changed:
            app.set(near=value)
        hint("Cuts away everything nearer to the camera than this, in units of the grid.")


def _cut(app: App, box: crop.Box | None) -> None:
    app.crop.remember(app)
    app.set(crop=box)


def _faces(app: App, pack: Pack) -> None:
    outer = crop.whole(pack)
    for face, (axis, side) in enumerate(crop.FACES):
        assert app.settings.crop is not None
        label(f"{'xyz'[axis]} {'from' if side == 0 else 'to'}")
        before = app.settings.crop
        value = before[side][axis]
        changed, value = imgui.slider_float(f"##face{face}", value, outer[0][axis], outer[1][axis], "%.3f")
        if imgui.is_item_activated():
            app.crop.remember(app)
        if changed:
            app.set(crop=crop.with_face(pack, before, face, value))
