"""The whole interface of one frame, in an imgui context of its own; drawn into a window or into any framebuffer.

The renderer's and imgui's OpenGL calls share a context, so the caller binds the target framebuffer before `draw`.
"""

import functools
from collections.abc import Callable
from typing import Any

from imgui_bundle import ImVec2, imgui, implot
from imgui_bundle import icons_fontawesome_6 as fa

from console.streams import printable
from viewer.app.application import App
from viewer.core import language, theme
from viewer.core.input import KeyPress
from viewer.core.state import Clipboard
from viewer.core.tasks import Task
from viewer.core.widgets import begin_modal, confirmed, heading, in_front, main_button, paragraph, pressed_here, px
from viewer.features.crop.panel import CropGizmo
from viewer.features.export import panel as export_panel
from viewer.features.export.panel import PreviewPane
from viewer.features.making import panel as making_panel
from viewer.features.opening.panel import FileDialogs, OpenDialog
from viewer.interface import keys, layout, top_bar, viewport
from viewer.rendering.canvas import Canvas

GLSL_VERSION = "#version 330"
MOST_ROUNDS = 32  # of reading input before a frame is drawn; see Ui.frame
DOUBLE_CLICK_S = 0.45  # imgui's own 0.3 s is less than desktops grant, and a slow picture takes some of it


class SystemClipboard(Clipboard):
    @property
    def text(self) -> str:
        return imgui.get_clipboard_text() or ""

    @text.setter
    def text(self, text: str) -> None:
        imgui.set_clipboard_text(text)


class Ui:
    """Dear ImGui and the panels. An OpenGL context must be current, now and whenever it is used.

    window: address of a GLFW window whose events to listen to; None where the caller feeds `imgui.get_io()` itself. With a
    window, letters that our fonts lack are taken from the system's; pictures without one are the same everywhere.
    """

    def __init__(self, window: int | None = None) -> None:
        self.context = imgui.create_context()
        imgui.set_current_context(self.context)  # another may be there already
        io = imgui.get_io()
        io.mouse_double_click_time = DOUBLE_CLICK_S
        io.set_ini_filename("")  # the layout is remembered by viewer.app
        io.config_flags |= imgui.ConfigFlags_.docking_enable
        self.context.config_nav_windowing_key_next = imgui.Key.none  # Ctrl+Tab is the packs'
        self.context.config_nav_windowing_key_prev = imgui.Key.none
        self._docking = layout.Docking()
        self._gizmo, self._preview_pane = CropGizmo(), PreviewPane()
        self.fonts = theme.Fonts()
        self._presses = keys.Presses()
        self.scale, self._theme = 0.0, ""
        self._window = window
        if window is not None:
            imgui.backends.glfw_init_for_opengl(window, True)
        imgui.backends.opengl3_init(GLSL_VERSION)
        missing = self.fonts.missing if window is not None else ""
        self._font_search = Task(lambda: theme.load_fonts(missing)) if missing else None
        self.plots = implot.create_context()
        self.file_dialogs = FileDialogs(has_window=window is not None)
        self.open_dialog = OpenDialog(self.file_dialogs.native)

    def pressed(self, press: KeyPress) -> None:
        """A key or a character; call before imgui hears of it."""
        imgui.set_current_context(self.context)
        self._presses.append((imgui.get_current_context().input_events_next_event_id, press))

    def modifier_changes(self) -> None:
        """Ctrl, Shift, Alt or Cmd goes down or up; call before imgui hears of it.

        imgui would take a key and the modifier let go of after it in one round, and read Ctrl+V as V. A key that nobody
        has, down and up, ends the round between them.
        """
        imgui.set_current_context(self.context)
        for down in (True, False):
            imgui.get_io().add_key_event(imgui.Key.f24, down)

    def frame(self, app: App, canvas: Canvas, scale: float = 1.0) -> None:
        """Draws the panels for this moment's state into imgui's lists, and hands the user's wishes to `app`.

        imgui takes a change of one key or button from its queue at a time. Rounds that are not drawn take them all, so
        that what was typed or clicked during a slow frame is not spread over as many slow frames.

        scale: how many times denser than usual the window's units are. Without a window, set io.display_size,
        io.display_framebuffer_scale and io.delta_time before.
        """
        imgui.set_current_context(self.context)
        implot.set_current_context(self.plots)
        theme.fonts = self.fonts
        for _ in range(MOST_ROUNDS):
            self._round(app, canvas, scale)
            if keys.queue_is_empty():
                break

    def _round(self, app: App, canvas: Canvas, scale: float) -> None:
        if self.scale == 0:
            self._docking.restore(app.interface.layout)
        self._take_fonts(app)
        scale *= app.interface.scale
        if app.interface.language != language.current():
            language.use(app.interface.language)
        if (scale, app.interface.theme) != (self.scale, self._theme):
            if self.scale and scale != self.scale:
                self._docking.rescale(scale / self.scale)
            theme.apply(app.interface.theme, scale)
            self.scale, self._theme = scale, app.interface.theme
        imgui.backends.opengl3_new_frame()
        if self._window is not None:
            imgui.backends.glfw_new_frame()
        moves = imgui.ConfigFlags_.nav_enable_keyboard  # among a dialog's widgets; else keys are the picture's
        flags = imgui.get_io().config_flags & ~moves
        imgui.get_io().config_flags = flags | moves if in_front(app) else flags
        imgui.new_frame()
        keys.dispatch(app, self._presses)
        size = imgui.get_io().display_size
        regions = layout.regions(size.x, size.y, app)
        picture = self._docking.space(app, regions.dock, regions.pages)
        viewport.show(app, canvas, picture, self._gizmo)
        if app.interface.panels_shown:
            top_bar.show(app, regions.top)
            layout.show_rail(app, regions)
        layout.show_pages(app, canvas, regions)
        making_panel.show_job(app, canvas, picture)
        export_panel.show_card(app, picture)
        export_panel.show_sharing(app, picture)
        making_panel.show_review(app, canvas, picture)
        keys.show(app)
        self.open_dialog.show(app)
        self.file_dialogs.show(app)
        making_panel.show(app, canvas)
        export_panel.show(app, canvas, self._preview_pane)
        _show_dialog(app, canvas)
        imgui.render()
        app.keyboard.seen()

    def _take_fonts(self, app: App) -> None:
        """Adds what the search has found, one font a frame."""
        search = self._font_search
        if search is not None and search.finished:
            if found := search.result():
                self.fonts.add(found.pop(0))
                app.touch()
            else:
                self._font_search = None

    @property
    def changes_soon(self) -> bool:
        """Whether frames must be drawn without input: letters are being read, or the mouse rests where a tip will show. imgui
        measures that rest, and then the tip's size, only while frames are drawn."""
        item, waited = self.context.hover_item_delay_id, self.context.hover_item_delay_timer
        rests = self.context.hover_item_unlocked_stationary_id == item
        hidden = any(window.active and window.hidden_frames_cannot_skip_items for window in self.context.windows)
        shows = rests and waited >= self.context.style.hover_delay_short and not hidden
        return self._font_search is not None or bool(item and not shows)

    def draw(self) -> None:
        """Draws what `frame` prepared into the framebuffer that is bound."""
        imgui.backends.opengl3_render_draw_data(imgui.get_draw_data())

    @property
    def background(self) -> tuple[float, float, float]:
        """The colour behind all, red, green, blue in 0 … 1."""
        base = theme.rgb(theme.BASE)
        return base.x, base.y, base.z

    @property
    def layout(self) -> str:
        imgui.set_current_context(self.context)
        return self._docking.text

    @property
    def typing(self) -> bool:
        """Whether a text field has the keyboard, so that its cursor must blink."""
        return imgui.get_io().want_text_input

    @property
    def hears(self) -> bool:
        """Whether there is input that no frame has seen."""
        imgui.set_current_context(self.context)
        return not keys.queue_is_empty()

    def release(self) -> None:
        imgui.set_current_context(self.context)
        implot.destroy_context(self.plots)
        imgui.backends.opengl3_shutdown()
        if self._window is not None:
            imgui.backends.glfw_shutdown()
        imgui.destroy_context(self.context)


def _show_dialog(app: App, canvas: Canvas) -> None:
    """Draws the oldest dialog that is not answered, in the middle; Enter and Escape answer it with its first button."""
    if not app.messages.dialogs:
        return
    dialog = app.messages.dialogs[0]
    if not begin_modal("##dialog", 480, 0.45, padding=(24, 22)):
        return
    icon = fa.ICON_FA_TRIANGLE_EXCLAMATION if dialog.failed else fa.ICON_FA_CIRCLE_INFO
    heading(icon, dialog.title, theme.WARN if dialog.failed else theme.ACCENT, 18.0)
    imgui.dummy(ImVec2(0, px(2)))
    paragraph(dialog.text, theme.MUTED)
    if dialog.rejected is not None:
        imgui.dummy(ImVec2(0, px(2)))
        making_panel.show_rejected(app, canvas, dialog.rejected)
    imgui.dummy(ImVec2(0, px(6)))
    answer = _dialog_buttons(dialog.buttons)
    if answer is None and pressed_here(imgui.Key.escape):
        answer = ""
    elif answer is None and confirmed():
        answer = dialog.buttons[0][1]
    if answer is not None:
        app.messages.dialogs.pop(0)
        imgui.close_current_popup()
        if answer:
            app.run(answer)
    imgui.end_popup()


def _dialog_buttons(buttons: tuple[tuple[str, str], ...]) -> str | None:
    """Draws them from the right; the command id of the one that was pressed, "" for none to run."""
    width, answer = max(px(104), *(imgui.calc_text_size(text).x + px(24) for text, _ in buttons)), None
    imgui.set_cursor_pos_x(imgui.get_window_width() - px(24) - len(buttons) * (width + px(8)) + px(8))
    for i, (text, command) in enumerate(reversed(buttons)):
        if i:
            imgui.same_line()
        last = i == len(buttons) - 1
        if main_button(text, width) if last else imgui.button(text, ImVec2(width, px(34))):
            answer = command
    return answer


# Functions that draw text or measure it. Not those of text fields, whose text is the user's.
SHOWN = {
    "text_unformatted", "button", "small_button", "selectable", "menu_item", "begin", "set_tooltip", "calc_text_size",
    "add_text", "begin_combo", "slider_float", "slider_int", "progress_bar",
}  # fmt: skip


def take_any_text() -> None:
    """From now on, functions of imgui that take text take any text of Python's, and SHOWN draw it in the interface's language."""
    for place in (imgui, imgui.ImDrawList):
        for name in dir(place):
            function = getattr(place, name)
            takes_text = type(function).__name__ in ("nb_func", "nb_method") and ": str" in (function.__doc__ or "")
            if takes_text and not name.startswith("_"):
                setattr(place, name, _with_any_text(function))


def _with_any_text(function: Callable[..., Any]) -> Callable[..., Any]:
    is_shown = function.__name__ in SHOWN

    @functools.wraps(function)
    def call(*words: Any, **named: Any) -> Any:
        if is_shown and language.current() != "en":
            words = tuple(language.translated(word) if isinstance(word, str) else word for word in words)
        try:
            return function(*words, **named)
        except TypeError:  # also of text that is not UTF-8
            again = [printable(word) if isinstance(word, str) else word for word in words]
            named_again = {name: printable(word) if isinstance(word, str) else word for name, word in named.items()}
            if again == list(words) and named_again == named:
                raise
            return function(*again, **named_again)

    return call


# Dear ImGui takes UTF-8 only; names of files may be anything.
take_any_text()
