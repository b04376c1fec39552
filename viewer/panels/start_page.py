"""What is seen while nothing is open: the demo, the packs opened lately, and how to open another."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from scenepack.files import PARAMS_NAME
from training.scenes.sources import FILMS
from viewer.app.application import App
from viewer.app.commands import run
from viewer.app.files import SESSION_SUFFIX
from viewer.panels import overlays, theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import coloured, elided, font, main_button, px

WIDTH = 440.0


def show(app: App, fonts: Fonts) -> None:
    """Draws the page in the middle of the window that is begun; beside the card of what is being made, if anything is."""
    width, height = imgui.get_window_width(), imgui.get_window_height()
    column = min(px(WIDTH), width - px(32))
    taken = px(overlays.WIDTH + overlays.MARGIN) if app.making.job or app.making.review else 0.0
    if taken and width - taken < column + px(32):
        return
    left = taken + 0.5 * (width - taken - column)
    recent = app.preferences.recent_packs()
    top = max(px(24), 0.5 * (height - px(342 + 40 * len(recent))))
    imgui.set_cursor_pos(ImVec2(left, top))
    imgui.begin_group()
    _restore_annotations(left)
    with font(fonts.bold, theme.HUGE):
        imgui.text_unformatted("snerg")
    with coloured(text=theme.MUTED):
        imgui.text_unformatted("Fly through scenes made from photographs.")
    imgui.dummy(ImVec2(0, px(14)))
    if app.demo is not None and main_button(f"{fa.ICON_FA_PLAY}  Open the demo scene", column):
        app.open(app.demo)
    _button(app, f"{fa.ICON_FA_FOLDER_OPEN}  Open…", "open", column)
    if app.sessions.last is not None:
        title = elided(app.sessions.last.title, column - px(210))
        _button(app, f"{fa.ICON_FA_CLOCK_ROTATE_LEFT}  Continue with {title}", "last-session", column)
    _button(app, f"{fa.ICON_FA_WAND_MAGIC_SPARKLES}  Make a scene from photographs…", "make", column)
    imgui.dummy(ImVec2(0, px(2)))
    with coloured(text=theme.FAINT):
        imgui.text_unformatted("or drop or paste a pack, a folder of photographs or a film")
    if recent:
        imgui.dummy(ImVec2(0, px(16)))
        with font(fonts.bold, theme.SMALL), coloured(text=theme.MUTED):
            imgui.text_unformatted("RECENT")
        for path in recent:
            _recent(app, path, column)
    imgui.end_group()


def _button(app: App, text: str, command: str, width: float) -> None:
    if imgui.button(text, ImVec2(width, px(34))):
        run(app, command)


def _recent(app: App, path: Path, width: float) -> None:
    at = imgui.get_cursor_screen_pos()
    with coloured(header_hovered=theme.CARD, header_active=theme.CONTROL):
        if imgui.selectable(f"##{path}", False, 0, ImVec2(width, px(30)))[0]:
            app.drop([path])
    draw = imgui.get_window_draw_list()
    middle = at.y + px(6)
    draw.add_text(ImVec2(at.x + px(6), middle), theme.packed(theme.ACCENT), icon_of(path))
    draw.add_text(ImVec2(at.x + px(32), middle), theme.packed(theme.TEXT), path.name)
    name = imgui.calc_text_size(path.name).x
    parent = str(path.parent)
    room = width - px(54) - name
    while parent and imgui.calc_text_size(parent).x > room and len(parent) > 4:
        parent = "…" + parent[2:]
    draw.add_text(ImVec2(at.x + px(44) + name, middle), theme.packed(theme.FAINT), parent)


def icon_of(path: Path) -> str:
    """What stands before a recent path, told by its name alone: this is drawn in every frame."""
    if path.suffix.lower() == ".zip" or (path / PARAMS_NAME).is_file() or (path / "pack").is_dir():
        return fa.ICON_FA_CUBE
    if path.suffix.lower() == SESSION_SUFFIX:
        return fa.ICON_FA_BOOKMARK
    return fa.ICON_FA_FILM if path.suffix.lower() in FILMS else fa.ICON_FA_IMAGES


def _restore_annotations(left: float) -> None:
    """The program's mark: voxels, one of them fully lit."""
    at = imgui.get_cursor_screen_pos()
    draw = imgui.get_window_draw_list()
    side, gap = px(20), px(5)
    for i, alpha in enumerate((1.0, 0.45, 0.7, 0.25, 0.7, 0.35)):
        low = ImVec2(at.x + (i % 3) * (side + gap), at.y + (i // 3) * (side + gap))
        draw.add_rect_filled(low, ImVec2(low.x + side, low.y + side), theme.packed(theme.ACCENT, alpha), px(5))
    imgui.dummy(ImVec2(1, 2 * side + gap + px(10)))
