"""Two packs under one camera."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.app.commands import ask_to_open
from viewer.panels.page_photographs import compare_controls
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, figure, hint


def show(app: App, canvas: CanvasInterface, fonts: Fonts) -> None:
    """Draws the page."""
    comparison = app.comparison
    with card("other", fonts, "The other pack"):
        if comparison.other is not None and comparison.other_path is not None:
            figure("Left", app.scene.name if app.scene is not None else "", fonts)
            figure("Right", comparison.other_path.name, fonts)
        else:
            hint("Choose a second pack, for example another bake of the same scene. Both use the same camera.")
        if imgui.button(f"{fa.ICON_FA_FOLDER_OPEN}  Choose a pack…", ImVec2(-1, 0)):
            ask_to_open(app, other=True)
    if comparison.against == "pack":
        compare_controls(app, fonts, "Compare")
