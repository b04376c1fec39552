"""Asking for a path: with the system's own dialog, or with a line to type into where the system has none."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from imgui_bundle import ImVec2, imgui
from imgui_bundle import portable_file_dialogs as pfd

from viewer.app.application import App
from viewer.app.files import FileRequest
from viewer.app.open_prompt import expanded
from viewer.panels import theme
from viewer.panels.modal import in_front
from viewer.panels.theme import Fonts
from viewer.panels.widgets import begin_modal, coloured, font, hint, main_button, px

NAME = "##path"
HELPERS = ("zenity", "kdialog", "matedialog", "qarma")


class FileDialogs:
    """The dialog of the moment. native: None asks the system whether it has dialogs."""

    def __init__(self, native: bool | None = None) -> None:
        if native is None:
            native = not sys.platform.startswith("linux") or any(shutil.which(name) for name in HELPERS)
        self.native = native
        self._request: FileRequest | None = None
        self._dialog = None
        self._text = ""

    def show(self, app: App, size: ImVec2, fonts: Fonts) -> None:
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
                self._end(app, str(chosen) if chosen else "")
        elif in_front(app) == "path":
            self._typed(app, size, fonts)

    def _begin(self, request: FileRequest) -> None:
        self._request, self._text = request, ""
        start = str(request.start or "")
        if request.kind == "save":
            self._text = str((request.start or Path.cwd()) / request.suggestion)
        elif start:
            self._text = start
        if not self.native:
            return
        filters = [f"*{suffix}" for suffix in request.suffixes]
        filters = ["Files", " ".join(filters)] if filters else ["All files", "*"]
        if request.kind == "folder":
            self._dialog = pfd.select_folder(request.title, start)
        elif request.kind == "open":
            self._dialog = pfd.open_file(request.title, start, filters)
        else:
            self._dialog = pfd.save_file(request.title, self._text, filters)

    def _end(self, app: App, chosen: str) -> None:
        """The user chose a path, or "" for none."""
        request, self._request, self._dialog = self._request, None, None
        app.file_request = None
        app.touch()
        if not chosen or request is None:
            return
        path = expanded(chosen)
        if request.kind == "save" and request.suffixes and path.suffix.lower() not in request.suffixes:
            path = path.with_name(path.name + request.suffixes[0])
        try:
            request.then(path)
        except Exception as error:  # a dialog, and the program goes on
            app.messages.fail(f"{path.name} cannot be used", error)

    def _typed(self, app: App, size: ImVec2, fonts: Fonts) -> None:
        assert self._request is not None
        opening = not imgui.is_popup_open(NAME)
        if not begin_modal(NAME, size, 540, 0.4, padding=(24, 22)):
            return
        with font(fonts.bold, 18.0):
            imgui.text_unformatted(self._request.title)
        if opening:
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(-1)
        with coloured(frame_bg=theme.BASE):
            entered, self._text = imgui.input_text_with_hint(
                "##typed", "Path", self._text, imgui.InputTextFlags_.enter_returns_true
            )
        hint("Or drop it on the window." if self._request.kind != "save" else "An existing file is replaced.")
        width = px(104)
        imgui.set_cursor_pos_x(imgui.get_window_width() - px(24) - 2 * width - px(8))
        cancelled = imgui.button("Cancel", ImVec2(width, px(34))) or imgui.is_key_pressed(imgui.Key.escape, False)
        imgui.same_line()
        chosen = main_button("Save" if self._request.kind == "save" else "Open", width) or entered
        if cancelled or chosen:
            imgui.close_current_popup()
        imgui.end_popup()
        if cancelled or chosen:
            self._end(app, self._text.strip() if chosen and not cancelled else "")
