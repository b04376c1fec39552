"""The bar on top: what is open, how fast it is drawn, and what is wanted often."""

from functools import partial

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core import theme
from viewer.core.input import shown_keys
from viewer.core.widgets import Box, Entry, coloured, draw_voxels, elided, font, more_button, px, tip, write
from viewer.interface import layout

LEFT, MARK, WORD, NAME_GAP, GAP, EDGE = 12.0, 42.0, 52.0, 28.0, 12.0, 8.0  # units at 100 %
BUTTON, STEP = 34.0, 38.0
NAME = 220.0  # a longer name is cut short before anything else has to go
PACKS = "##packs"
SHORTEST_NAME, LEAST_BUTTONS = 72.0, 2
FRAMES = "0000 fps"  # as wide as it gets
START_ICONS = {"help": fa.ICON_FA_KEYBOARD, "full-screen": fa.ICON_FA_UP_RIGHT_AND_DOWN_LEFT_FROM_CENTER}  # of commands
ICONS = {
    "open": fa.ICON_FA_FOLDER_OPEN,
    "save": fa.ICON_FA_CAMERA,
    "home": fa.ICON_FA_HOUSE,
    "frame": fa.ICON_FA_EXPAND,
    **START_ICONS,
}


def _plan(width: float, name: float, details: float, speed: float, buttons: int) -> tuple[float, bool, bool, bool, int]:
    """Divides a bar so that nothing overlaps: the width of the scene's name; whether its voxels, the program's name and the
    frames per second are shown; and how many buttons stand there. The others are in a menu behind them.

    width: of the bar. name, details, speed: widths, 0 for what there is not. buttons: how many there are.
    """
    # From everything to the least; the first of which the name has enough space.
    steps = [(True, True, True, buttons), (False, True, True, buttons), (False, False, True, buttons)]
    steps += [(False, False, False, shown) for shown in range(buttons, LEAST_BUTTONS - 1, -1)]

    def left(with_details: bool, with_word: bool, with_speed: bool, shown: int) -> float:
        """For the scene's name."""
        fixed = MARK + WORD * with_word + NAME_GAP * (name > 0) + STEP * (shown + (shown < buttons)) + EDGE
        fixed += GAP * (with_details and details > 0) + GAP * (1 + (with_speed and speed > 0))
        return width - px(fixed) - details * with_details - speed * with_speed

    suffices = (step for step in steps if left(*step) >= min(name, px(NAME if step[2] else SHORTEST_NAME)))
    chosen = next(suffices, steps[-1])
    return max(0.0, min(name, left(*chosen))), *chosen


def show(app: App, box: Box) -> None:
    with coloured(window_bg=theme.BASE):
        layout.begin("##top", box, (LEFT, EDGE))
    entries = _entries(app)
    name = imgui.calc_text_size(app.scene.name).x if app.scene is not None else 0.0
    with font(None, theme.SMALL):
        details = imgui.calc_text_size(state_of(app)).x
    with font(theme.fonts.bold, theme.SMALL):
        speed = imgui.calc_text_size(FRAMES).x if app.scene is not None and app.times.frame_ms else 0.0
    name, with_details, with_word, with_speed, buttons = _plan(box[2], name, details, speed, len(entries))
    _logo(with_word)
    if name > 0:
        _name(app, px(MARK + WORD * with_word), name, with_details=with_details)
    menu = buttons < len(entries)
    x = imgui.get_window_width() - px(EDGE - STEP + BUTTON) - px(STEP) * (buttons + menu)
    if with_speed and speed:
        text = f"{app.times.fps:.0f} fps"
        with font(theme.fonts.bold, theme.SMALL):
            imgui.same_line()
            imgui.set_cursor_pos(ImVec2(x - px(GAP) - imgui.calc_text_size(text).x, px(16)))
            write(text, theme.ACCENT)
    for i, entry in enumerate(entries[:buttons]):
        imgui.set_cursor_pos(ImVec2(x + i * px(STEP), px(EDGE)))
        entry.button()
    if menu:
        imgui.set_cursor_pos(ImVec2(x + buttons * px(STEP), px(EDGE)))
        more_button("top more", entries[buttons:])
    _packs(app)
    imgui.end()


def _entries(app: App) -> list[Entry]:
    shown = []
    for name, icon in (ICONS if app.scene is not None else START_ICONS).items():
        keys = min(COMMANDS[name].keys, key=len)
        shown.append(Entry(f"top {name}", icon, COMMANDS[name].title, partial(app.run, name), shown_keys(keys)))
    if app.scene is not None and app.open_packs.packs:
        title = f"{len(app.open_packs.packs) + 1} packs are open"
        ask = partial(setattr, app.open_packs, "show_list", True)
        shown.insert(0, Entry("top packs", fa.ICON_FA_LAYER_GROUP, title, ask, "Ctrl+Tab"))
    return shown


def _packs(app: App) -> None:
    """The list of open packs, while it is wanted: a click shows one."""
    if app.open_packs.show_list:
        app.open_packs.show_list = False
        imgui.open_popup(PACKS)
    if not imgui.begin_popup(PACKS):
        return
    if app.scene is not None:
        imgui.menu_item(f"{fa.ICON_FA_CUBE}   {app.scene.name}##shown", "", True)
    for i, scene in enumerate(app.open_packs.packs):
        if imgui.menu_item(f"{fa.ICON_FA_CUBE}   {scene.name}##{i}", "", False)[0]:
            app.open_packs.switch_to(app, scene)
            break
    imgui.separator()
    if imgui.menu_item(f"{fa.ICON_FA_XMARK}   Close this one", shown_keys("Ctrl+W"), False)[0]:
        app.run("close")
    imgui.end_popup()


def _logo(word: bool) -> None:
    """The program's mark: a cube of voxels, one of them lit, and its name."""
    at = imgui.get_cursor_screen_pos()
    draw_voxels(ImVec2(at.x + px(2), at.y + px(7)), (1.0, 0.45, 0.25, 0.7), 2, side=8, gap=2)
    if word:
        imgui.set_cursor_pos(ImVec2(px(MARK), px(14)))
        write("snerg", face=theme.fonts.bold, size=17.0)


def _name(app: App, x: float, width: float, *, with_details: bool) -> None:
    scene = app.open_scene
    corner, draw = imgui.get_window_pos(), imgui.get_window_draw_list()
    line = corner.x + x + px(0.5 * NAME_GAP)
    draw.add_line(ImVec2(line, corner.y + px(15)), ImVec2(line, corner.y + px(33)), theme.packed(theme.LINE), px(1))
    imgui.set_cursor_pos(ImVec2(x + px(NAME_GAP), px(15)))
    imgui.text_unformatted(elided(scene.name, width))
    tip(f"{scene.name}\n{scene.path}\n{state_of(app)}")
    if not with_details:
        return
    imgui.same_line(0, px(GAP))
    imgui.set_cursor_pos_y(px(16))
    whole = scene.whole and not _is_uploading(app)
    write(state_of(app), theme.FAINT if whole else theme.WARN, size=theme.SMALL)


def state_of(app: App) -> str:
    """What the pack that is shown consists of, or how far it is read: a preview's voxels are not its own."""
    if app.scene is None:
        return ""
    if not app.scene.whole:
        images = app.loading.images if app.loading is not None else (0, 0)
        return f"loading {images[0]} of {images[1]} images" if images[1] else "loading"
    if _is_uploading(app):
        return "uploading to the graphics card"
    return " × ".join(str(side) for side in app.scene.pack.grid_size) + " voxels"


def _is_uploading(app: App) -> bool:
    """Whether a coarser version is shown until the pack is on the GPU."""
    return app.canvas is not None and app.canvas.refines
