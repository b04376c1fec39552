"""Dialogs that ask for files and folders, of the system where it has them, and the start page."""

import shutil
import sys
from pathlib import Path
from typing import Literal

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa
from imgui_bundle import portable_file_dialogs as pfd

from scenepack.files import PARAMS_NAME
from training.scenes.sources import FILMS
from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.files import SESSION_SUFFIX, FileRequest
from viewer.core.language import translated
from viewer.core.widgets import CARD_MARGIN, CARD_WIDTH, px
from viewer.features.opening.opening import OpenPrompt, browse, choose, expanded

TITLE = "##path"
HELPERS = ("zenity", "kdialog", "matedialog", "qarma")


class FileDialogs:
    """The dialog of the moment: for a window, the system's, where it has dialogs; else one that a path is typed into."""

    def __init__(self, has_window: bool) -> None:
        elsewhere = not sys.platform.startswith("linux")
        self.native = has_window and (elsewhere or any(shutil.which(name) for name in HELPERS))
        self._request: FileRequest | None = None
        self._dialog = None
        self._text = ""

    def show(self, app: App) -> None:
        """Opens the dialog that `app` asks for, and hands over what was chosen."""
        if app.file_request is None:
            return
        if app.file_request is not self._request:
            self._begin(app.file_request)
        if self.native:
            app.touch(1)
            if self._dialog is not None and self._dialog.ready(5):
                result = self._dialog.result()
                chosen = result[0] if isinstance(result, list) and result else result
                self._end(app, app.file_request, str(chosen) if chosen else "")
        elif ui.in_front(app) == "path":
            self._typed(app, app.file_request)

    def _begin(self, request: FileRequest) -> None:
        self._request = request
        self._text = str(request.start or "")
        if request.kind == "save":
            self._text = str((request.start or Path.cwd()) / request.suggestion)
        if not self.native:
            return
        filters = [f"*{suffix}" for suffix in request.suffixes]
        filters = ["Files", " ".join(filters)] if filters else ["All files", "*"]
        if request.kind == "folder":
            self._dialog = pfd.select_folder(request.title, self._text)
        else:
            ask = pfd.open_file if request.kind == "open" else pfd.save_file
            self._dialog = ask(request.title, self._text, filters)

    def _end(self, app: App, request: FileRequest, chosen: str) -> None:
        """The user chose a path, or "" for none."""
        app.file_request = self._request = self._dialog = None
        app.touch()
        if not chosen:
            return
        path = expanded(chosen)
        if request.kind == "save" and request.suffixes and path.suffix.lower() not in request.suffixes:
            path = path.with_name(path.name + request.suffixes[0])
        with app.messages.as_dialog(f"{path.name} cannot be used"):
            request.then(path)

    def _typed(self, app: App, request: FileRequest) -> None:
        opening = not imgui.is_popup_open(TITLE)
        if not ui.begin_modal(TITLE, 540, 0.4, padding=(24, 22)):
            return
        ui.write(request.title, face=theme.fonts.bold, size=18.0)
        if opening:
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(-1)
        with ui.coloured(frame_bg=theme.BASE):
            flags = imgui.InputTextFlags_.enter_returns_true
            entered, self._text = imgui.input_text_with_hint("##typed", translated("Path"), self._text, flags)
        saves = request.kind == "save"
        ui.hint("An existing file is replaced." if saves else "Or drop it on the window.")
        cancelled, chosen = ui.cancel_or("Save" if saves else "Open", 104, 24)
        if cancelled or chosen or entered:
            imgui.close_current_popup()
            self._end(app, request, "" if cancelled else self._text.strip())
        imgui.end_popup()


# --- Open prompt ---
NAME, FIELD = "##open", "##open path"
ENTER = (imgui.Key.enter, imgui.Key.keypad_enter)
TO_END = 3
WIDTH, LINE, BUTTON = 600.0, 30.0, 104.0
BROWSED: dict[Literal["open", "folder"], str] = {  # buttons of the system's dialogs
    "open": f"{fa.ICON_FA_FILE}  File…",
    "folder": f"{fa.ICON_FA_FOLDER_OPEN}  Folder…",
}
KINDS = {  # what stands before and behind a path
    "pack": (fa.ICON_FA_CUBE, "Pack"),
    "run": (fa.ICON_FA_GEARS, "Training run"),
    "scene": (fa.ICON_FA_IMAGES, "Scene"),
    "pictures": (fa.ICON_FA_IMAGES, "Photographs"),
    "film": (fa.ICON_FA_FILM, "Film"),
    "session": (fa.ICON_FA_BOOKMARK, "Session"),
    "unknown": (fa.ICON_FA_FOLDER, ""),
}


class OpenDialog:
    """The dialog while app.open_prompt is there. native: whether the system has dialogs of its own."""

    def __init__(self, native: bool) -> None:
        self.native = native
        self._shown: OpenPrompt | None = None
        self._frames_to_end = 0  # in which the cursor is put behind the text, for a field that is entered selects all
        self._awaited = False  # the field has been given the keyboard and has not taken it yet

    def show(self, app: App) -> None:
        """Draws it while nothing is in front of it, and hands over what was chosen."""
        open_prompt = app.open_prompt
        if open_prompt is None:
            self._shown = None
            return
        if ui.in_front(app) != "open":
            return
        opening = open_prompt is not self._shown or not imgui.is_popup_open(NAME)
        self._shown = open_prompt
        imgui.set_next_window_size_constraints(ImVec2(0, 0), ImVec2(1e6, 0.86 * imgui.get_io().display_size.y))
        if not ui.begin_modal(NAME, WIDTH, 0.12, pivot=0.0, padding=(24, 20)):
            return
        ui.write("Compare with" if open_prompt.other else "Open", face=theme.fonts.bold, size=18.0)
        what = "A pack: a folder or a .zip." if open_prompt.other else "A pack, photographs, a film or a training run."
        ui.hint(f"{what} Type a path, or a part of one that you opened lately.")
        entered = self._field(open_prompt, opening)
        if open_prompt.problem:
            ui.hint(open_prompt.problem, theme.WARN)
        if open_prompt.lines and not open_prompt.text.strip():
            ui.hint("RECENT", theme.MUTED)
        clicked = [number for number in range(len(open_prompt.lines)) if _line(open_prompt, number)]
        imgui.dummy(ImVec2(0, px(4)))
        browsed = ""
        if self.native:
            for kind, title in BROWSED.items():
                browsed = kind if ui.button(title, px(BUTTON), px(34)) else browsed
                imgui.same_line()
        cancelled, pressed = ui.cancel_or("Open", BUTTON, 24)
        if browsed:
            browse(app, browsed, other=open_prompt.other)
        elif cancelled:
            app.open_prompt = None
        elif clicked or entered or pressed:
            choose(app, clicked[0] if clicked else None)
            self._frames_to_end, self._awaited = TO_END, True
        if app.open_prompt is None:
            imgui.close_current_popup()
        imgui.end_popup()

    def _field(self, open_prompt: OpenPrompt, opening: bool) -> bool:
        """The line to type into; whether Enter was pressed in it."""
        # Down and Up choose a line; imgui would move the keyboard to its button, and lose an Enter in the next round.
        if opening or self._awaited or imgui.get_current_context().nav_id == imgui.get_id(FIELD):
            by = int(imgui.is_key_pressed(imgui.Key.down_arrow)) - int(imgui.is_key_pressed(imgui.Key.up_arrow))
            if by:
                imgui.internal.nav_move_request_cancel()
                open_prompt.step(by)
        # The field itself does not hear Enter in the round after it took the keyboard.
        has_keyboard = self._awaited or imgui.get_current_context().active_id == imgui.get_id(FIELD)
        entered = has_keyboard and any(imgui.is_key_pressed(key, False) for key in ENTER)
        if opening or self._frames_to_end == TO_END:
            imgui.set_keyboard_focus_here()
        if self._frames_to_end:  # a folder was chosen, whose name stands there now
            self._frames_to_end -= 1
            state = imgui.internal.get_input_text_state(imgui.get_id(FIELD))
            if state is not None:
                state.reload_user_buf_and_move_to_end()
        imgui.set_next_item_width(-1)
        with ui.coloured(frame_bg=theme.BASE):
            open_prompt.type(imgui.input_text_with_hint(FIELD, "/path/to/scene", open_prompt.text)[1])
        self._awaited = opening or (self._awaited and not imgui.is_item_active())
        return entered


def _line(open_prompt: OpenPrompt, number: int) -> bool:
    path, kind = open_prompt.lines[number], open_prompt.kind(open_prompt.lines[number])
    at, width = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
    with ui.coloured(header_hovered=theme.CONTROL, header_active=theme.CONTROL_HOT):
        flags, size = imgui.SelectableFlags_.no_auto_close_popups, ImVec2(width, px(LINE))
        pressed = imgui.selectable(f"##line {number}", number == open_prompt.picked, flags, size)[0]
    icon, note = KINDS["film" if kind == "pictures" and path.is_file() else kind]
    draw, middle = imgui.get_window_draw_list(), at.y + px(6)
    draw.add_text(ImVec2(at.x + px(6), middle), theme.packed(theme.FAINT if kind == "unknown" else theme.ACCENT), icon)
    wide = imgui.calc_text_size(note).x
    draw.add_text(ImVec2(at.x + width - wide - px(6), middle), theme.packed(theme.FAINT), note)
    name = ui.elided(path.name or str(path), width - wide - px(60))
    draw.add_text(ImVec2(at.x + px(34), middle), theme.packed(theme.TEXT), name)
    left = at.x + px(46) + imgui.calc_text_size(name).x
    parent = ui.elided(str(path.parent), at.x + width - wide - px(18) - left)
    draw.add_text(ImVec2(left, middle), theme.packed(theme.FAINT), parent)
    return pressed


# --- Start page ---
COLUMN = 440.0


def show_start_page(app: App) -> None:
    """Draws the page in the middle of the window that is begun; beside the card of what is being made, if anything is."""
    width, height = imgui.get_window_width(), imgui.get_window_height()
    column = min(px(COLUMN), width - px(32))
    taken = px(CARD_WIDTH + CARD_MARGIN) if app.making.job or app.making.review else 0.0
    if taken and width - taken < column + px(32):
        return
    left = taken + 0.5 * (width - taken - column)
    recent = app.preferences.recent_packs()
    top = max(px(24), 0.5 * (height - px(342 + 40 * len(recent))))
    imgui.set_cursor_pos(ImVec2(left, top))
    imgui.begin_group()
    opacities = (1.0, 0.45, 0.7, 0.25, 0.7, 0.35)
    ui.draw_voxels(imgui.get_cursor_screen_pos(), opacities, 3, side=20, gap=5)
    imgui.dummy(ImVec2(1, 2 * px(20) + px(5) + px(10)))
    ui.write("snerg", face=theme.fonts.bold, size=theme.HUGE)
    ui.write("Fly through scenes made from photographs.", theme.MUTED)
    imgui.dummy(ImVec2(0, px(14)))
    if app.demo is not None and ui.main_button(f"{fa.ICON_FA_PLAY}  Open the demo scene", column):
        app.open(app.demo)
    ui.command(app, "open", f"{fa.ICON_FA_FOLDER_OPEN}  Open…", column, px(34))
    if app.sessions.last is not None:
        title = ui.elided(app.sessions.last.title, column - px(210))
        ui.command(app, "last-session", f"{fa.ICON_FA_CLOCK_ROTATE_LEFT}  Continue with {title}", column, px(34))
    ui.command(app, "make", f"{fa.ICON_FA_WAND_MAGIC_SPARKLES}  Make a scene from photographs…", column, px(34))
    imgui.dummy(ImVec2(0, px(2)))
    ui.write("or drop or paste a pack, a folder of photographs or a film", theme.FAINT)
    if recent:
        imgui.dummy(ImVec2(0, px(16)))
        ui.write("RECENT", theme.MUTED, theme.fonts.bold, theme.SMALL)
        for path in recent:
            _recent(app, path, column)
    imgui.end_group()


def _recent(app: App, path: Path, width: float) -> None:
    at = imgui.get_cursor_screen_pos()
    with ui.coloured(header_hovered=theme.CARD, header_active=theme.CONTROL):
        if imgui.selectable(f"##{path}", False, 0, ImVec2(width, px(30)))[0]:
            app.drop([path])
    draw = imgui.get_window_draw_list()
    middle = at.y + px(6)
    draw.add_text(ImVec2(at.x + px(6), middle), theme.packed(theme.ACCENT), icon_of(path))
    shown = ui.elided(path.name, width - px(120))
    draw.add_text(ImVec2(at.x + px(32), middle), theme.packed(theme.TEXT), shown)
    name = imgui.calc_text_size(shown).x
    parent = ui.elided_start(str(path.parent), width - px(54) - name)
    draw.add_text(ImVec2(at.x + px(44) + name, middle), theme.packed(theme.FAINT), parent)


def icon_of(path: Path) -> str:
    """The icon of a recent path, by its name alone: this is drawn in every frame."""
    if path.suffix.lower() == ".zip" or (path / PARAMS_NAME).is_file() or (path / "pack").is_dir():
        return fa.ICON_FA_CUBE
    if path.suffix.lower() == SESSION_SUFFIX:
        return fa.ICON_FA_BOOKMARK
    return fa.ICON_FA_FILM if path.suffix.lower() in FILMS else fa.ICON_FA_IMAGES
