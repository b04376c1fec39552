"""Small parts that all panels are made of: rows of label and control, cards, switches, icon buttons, dialogs."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeVar

from imgui_bundle import ImVec2, imgui, imgui_ctx
from imgui_bundle import icons_fontawesome_6 as fa

from viewer.core import theme
from viewer.core.language import translated

if TYPE_CHECKING:
    from viewer.app.application import App

T = TypeVar("T")
Box = tuple[float, float, float, float]  # x, y, width, height in window units
Region = tuple[tuple[float, float], tuple[float, float]]  # of a texture: its upper left and lower right corner, 0 … 1
LABEL_WIDTH = 104.0
WHOLE: Region = ((0.0, 0.0), (1.0, 1.0))
font = imgui_ctx.push_font  # text in another face (None: the same) and size (0: the same), in units of a 100 % display


def px(length: float) -> float:
    """A length in units of a 100 % display, in window units of this one."""
    return length * imgui.get_style().font_scale_dpi


@contextmanager
def coloured(**colours: str | tuple[str, float]) -> Iterator[None]:
    """Colours by imgui's names: coloured(text=theme.MUTED, button=(theme.ACCENT, 0.2))."""
    for name, colour in colours.items():
        code, alpha = colour if isinstance(colour, tuple) else (colour, 1.0)
        imgui.push_style_color(getattr(imgui.Col_, name), theme.rgb(code, alpha))
    yield
    imgui.pop_style_color(len(colours))


@contextmanager
def style(**lengths: float | tuple[float, float]) -> Iterator[None]:
    """Lengths by imgui's names, in units of a 100 % display: style(window_padding=(14, 12))."""
    for name, length in lengths.items():
        scaled = ImVec2(px(length[0]), px(length[1])) if isinstance(length, tuple) else px(length)
        imgui.push_style_var(getattr(imgui.StyleVar_, name), scaled)
    yield
    imgui.pop_style_var(len(lengths))


@contextmanager
def clipped(box: Box) -> Iterator[imgui.ImDrawList]:
    """The window's list to draw with, cut off at a box."""
    draw = imgui.get_window_draw_list()
    draw.push_clip_rect(ImVec2(box[0], box[1]), ImVec2(box[0] + box[2], box[1] + box[3]), True)
    yield draw
    draw.pop_clip_rect()


@contextmanager
def card(name: str, title: str) -> Iterator[None]:
    """A rounded box as wide as the panel and as high as what is in it."""
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    with style(window_padding=(14, 12)):
        imgui.begin_child(f"##card {name}", ImVec2(0, 0), flags)
    write(translated(title).upper(), theme.MUTED, theme.fonts.bold, theme.SMALL)
    imgui.dummy(ImVec2(0, px(1)))
    yield
    imgui.end_child()
    imgui.dummy(ImVec2(0, px(2)))


@contextmanager
def list_box(name: str, height: float) -> Iterator[None]:
    """A dark box whose lines scroll. height: window units."""
    with coloured(child_bg=theme.BASE):
        imgui.begin_child(name, ImVec2(0, height), imgui.ChildFlags_.always_use_window_padding)
    yield
    imgui.end_child()


def write(text: str, colour: str = theme.TEXT, face: imgui.ImFont | None = None, size: float = 0.0) -> None:
    """Text in a colour, another face (None: the same) and size (0: the same)."""
    with font(face, size), coloured(text=colour):
        imgui.text_unformatted(text)


def label(text: str, width: float = LABEL_WIDTH) -> None:
    """The left side of a row; the control that follows gets the rest of the width."""
    imgui.align_text_to_frame_padding()
    write(elided(text, px(width - 4)), theme.MUTED)  # a translation may be longer
    imgui.same_line(px(width))
    imgui.set_next_item_width(-1)


def labelled(name: str, width: float = LABEL_WIDTH) -> str:
    """Draws the label of a control named "Label##id" or "Label" at its left; none for "##id". Returns imgui's name of it."""
    text, _, id = name.partition("##")
    if text:
        label(text, width)
    return f"##{id or text}"


def figure(name: str, value: str, dot: str = "") -> None:
    """A row that only tells: name on the left, value on the right. dot: colour of a mark before it, as in a legend."""
    if dot:
        at, half = imgui.get_cursor_screen_pos(), 0.5 * imgui.get_text_line_height()
        imgui.get_window_draw_list().add_circle_filled(ImVec2(at.x + px(4), at.y + half), px(4), theme.packed(dot))
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + px(15))
    write(name, theme.MUTED)
    imgui.same_line()
    width = imgui.get_content_region_avail().x
    shown = elided(value, width)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + width - imgui.calc_text_size(shown).x)
    imgui.text_unformatted(shown)


def headline(number: str, unit: str) -> None:
    write(number, face=theme.fonts.bold, size=26.0)
    imgui.same_line(0, px(5))
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + px(9))
    write(unit, theme.MUTED)


def hint(text: str, colour: str = theme.FAINT) -> None:
    with font(None, theme.SMALL):
        paragraph(text, colour)


def paragraph(text: str, colour: str = theme.TEXT) -> None:
    with imgui_ctx.push_text_wrap_pos():
        write(text, colour)


def heading(icon: str, title: str, colour: str = theme.ACCENT, size: float = theme.LARGE) -> None:
    """The first line of a dialog or a card."""
    with font(theme.fonts.bold, size):
        write(icon, colour)
        imgui.same_line(0, px(size - 8))
        paragraph(title)


def tip(text: str) -> None:
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled):
        imgui.set_tooltip(text)


def choice(name: str, titles: Mapping[T, str], shown: str) -> T | None:
    """A drop-down list of named values; the value that was picked just now, else None. shown: the title of the present one."""
    picked = None
    if imgui.begin_combo(labelled(name), shown):
        for option, title in titles.items():
            if imgui.selectable(title, title == shown)[0]:
                picked = option
        imgui.end_combo()
    return picked


def segments(name: str, titles: Mapping[T, str], current: object, width: float = LABEL_WIDTH) -> T | None:
    """A few named values side by side, as one control; the value that was picked just now, else None. width: of the label."""
    name, picked = labelled(name, width), None
    gap, texts = px(2), [imgui.calc_text_size(title).x for title in titles.values()]
    whole = imgui.get_content_region_avail().x - gap * (len(titles) - 1)
    equal, spare = whole / len(titles), (whole - sum(texts)) / len(titles)
    fits = max(texts) + px(8) <= equal
    for i, (option, title) in enumerate(titles.items()):
        if i:
            imgui.same_line(0, gap)
        chosen = option == current
        face = {"button": theme.ACCENT, "button_hovered": theme.ACCENT, "text": theme.ON_ACCENT} if chosen else {}
        with style(frame_padding=(0, 6)), coloured(**face):
            if imgui.button(f"{title}{name}", ImVec2(equal if fits else texts[i] + spare, 0)):
                picked = option
    return picked


def explained(name: str, options: Mapping[T, tuple[str, str]], current: T, width: float = LABEL_WIDTH) -> T:
    """Segments with a line below that explains the chosen one; the value now. options: title and explanation by value."""
    picked = segments(name, {option: title for option, (title, _) in options.items()}, current, width)
    chosen = current if picked is None else picked
    hint(options[chosen][1])
    return chosen


def slider(
    name: str, value: float, low: float, high: float, words: str, *, times: float = 1.0, flags: int = 0
) -> float:
    """A slider that shows `value` `times` larger, between low and high, as printf's `words` say; the new value."""
    changed, moved = imgui.slider_float(labelled(name), times * value, low, high, words, flags)
    return moved / times if changed else value


def undoable_slider(app: App, name: str, value: float, low: float, high: float, words: str) -> float | None:
    """A slider whose drag is one step that can be undone; the value that it was moved to just now, else None."""
    changed, moved = imgui.slider_float(labelled(name), value, low, high, words)
    if imgui.is_item_activated() and app.scene is not None:
        app.scene.rig.remember()
    return moved if changed else None


def switch(name: str, on: bool, title: str = "") -> bool:
    """A sliding switch at the right end of a row, which begins with a title or a label; the new state."""
    height, width = px(18), px(32)
    if title:
        imgui.align_text_to_frame_padding()
        write(elided(title, imgui.get_content_region_avail().x - width - px(8)), theme.MUTED)
        imgui.same_line()
    x = imgui.get_content_region_avail().x - width
    imgui.set_cursor_pos(ImVec2(imgui.get_cursor_pos_x() + max(0.0, x), imgui.get_cursor_pos_y() + px(5)))
    at = imgui.get_cursor_screen_pos()
    if imgui.invisible_button(f"##{name}", ImVec2(width, height), imgui.ButtonFlags_.enable_nav):
        on = not on
    draw = imgui.get_window_draw_list()
    track = theme.ACCENT if on else theme.FAINT if imgui.is_item_hovered() else theme.CONTROL_HOT
    draw.add_rect_filled(at, ImVec2(at.x + width, at.y + height), theme.packed(track), height / 2)
    knob = at.x + (width - height / 2 if on else height / 2)
    colour = theme.packed(theme.ON_ACCENT if on else theme.TEXT)
    draw.add_circle_filled(ImVec2(knob, at.y + height / 2), height / 2 - px(3), colour)
    return on


def button(text: str, width: float = -1, height: float = 0, *, enabled: bool = True) -> bool:
    """A button. width, height: window units; -1 for all of the width, 0 for what the text needs."""
    imgui.begin_disabled(not enabled)
    pressed = imgui.button(text, ImVec2(width, height))
    imgui.end_disabled()
    return pressed


def command(app: App, name: str, text: str, width: float = -1, height: float = 0, *, enabled: bool = True) -> None:
    if button(text, width, height, enabled=enabled):
        app.run(name)


def icon_button(icon: str, name: str, tooltip: str, *, on: bool = False, enabled: bool = True) -> bool:
    """A square button without a frame; lit where `on`."""
    colours = {"button": (theme.ACCENT, 0.16 if on else 0.0), "text": theme.ACCENT if on else theme.MUTED}
    with coloured(**colours, button_hovered=theme.CONTROL):
        pressed = button(f"{icon}##{name}", px(34), px(32), enabled=enabled)
    tip(tooltip)
    return pressed


@dataclass(frozen=True)
class Entry:
    """What an icon button or a line of a menu does. icon: Font Awesome. hint: keys and the like, for the tooltip."""

    id: str
    icon: str
    title: str
    action: Callable[[], object]
    hint: str = ""
    on: bool = False

    def button(self) -> None:
        if icon_button(self.icon, self.id, f"{self.title}  ({self.hint})" if self.hint else self.title, on=self.on):
            self.action()


def more_button(name: str, entries: Sequence[Entry]) -> None:
    """A square button that opens a menu of what there was no room for."""
    if icon_button(fa.ICON_FA_ELLIPSIS, name, "More", on=any(entry.on for entry in entries)):
        imgui.open_popup(f"##{name}")
    if imgui.begin_popup(f"##{name}"):
        for entry in entries:
            if imgui.menu_item(f"{entry.icon}   {entry.title}", entry.hint, entry.on)[0]:
                entry.action()
        imgui.end_popup()


def elided(text: str, width: float) -> str:
    """`text`, or as much of its beginning as fits into `width` with an ellipsis behind it."""
    text = translated(text)
    if imgui.calc_text_size(text).x <= width:
        return text
    kept = bisect_right(range(1, len(text) + 1), width, key=lambda n: imgui.calc_text_size(f"{text[:n]}…").x)
    return f"{text[:kept].rstrip()}…" if kept else ""


def elided_start(text: str, width: float) -> str:
    """`text`, or an ellipsis and as much of its end as fits into `width`."""
    while imgui.calc_text_size(text).x > width and len(text) > 4:
        text = "…" + text[2:]
    return text


def draw_picture(
    texture: int, low: ImVec2, high: ImVec2, uv: Region = WHOLE, *, opacity: float = 1.0, rounding: float = 4.0
) -> None:
    """A texture, or a part of it, in a rectangle (window units)."""
    image, shade = imgui.ImTextureRef(texture), theme.packed("#ffffff", opacity)
    imgui.get_window_draw_list().add_image_rounded(image, low, high, *uv, shade, px(rounding))


def draw_voxels(at: ImVec2, opacities: Sequence[float], columns: int, *, side: float, gap: float) -> None:
    """The program's mark: voxels of these opacities, row by row. side, gap: in units; the gap is also the corners' radius."""
    draw, step, side = imgui.get_window_draw_list(), px(side) + px(gap), px(side)
    for i, opacity in enumerate(opacities):
        low = ImVec2(at.x + i % columns * step, at.y + i // columns * step)
        draw.add_rect_filled(low, ImVec2(low.x + side, low.y + side), theme.packed(theme.ACCENT, opacity), px(gap))


def chip(text: str, x: float, y: float) -> float:
    """A dark label on the picture, its upper left corner at x, y (window units); where its right edge is."""
    width, height = chip_size(text)
    corner = ImVec2(x + width, y + height)
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(ImVec2(x, y), corner, theme.packed(theme.BASE, 0.82), px(14))
    with font(None, theme.SMALL):
        draw.add_text(ImVec2(x + px(12), y + px(6)), theme.packed(theme.TEXT), text)
    return corner.x


def chip_size(text: str) -> tuple[float, float]:
    with font(None, theme.SMALL):
        size = imgui.calc_text_size(text)
    return size.x + px(24), size.y + px(12)


def main_button(text: str, width: float = -1, *, enabled: bool = True) -> bool:
    with coloured(button=theme.ACCENT, button_hovered=theme.TEXT, text=theme.ON_ACCENT):
        return button(text, width, px(34), enabled=enabled)


def half_width() -> float:
    """Of each of two buttons side by side."""
    return (imgui.get_content_region_avail().x - px(8)) / 2


def two_commands(app: App, left: tuple[str, str], right: tuple[str, str]) -> None:
    """Two buttons side by side; of each, the command and the text."""
    width = half_width()
    command(app, *left, width)
    imgui.same_line()
    command(app, *right, width)


def cancel_or(text: str, width: float, padding: float, *, enabled: bool = True) -> tuple[bool, bool]:
    """The last row of a dialog: whether it was cancelled, also by Escape; and whether `text` was pressed."""
    imgui.set_cursor_pos_x(imgui.get_window_width() - px(padding) - 2 * px(width) - px(8))
    cancelled = button("Cancel", px(width), px(34)) or pressed_here(imgui.Key.escape)
    imgui.same_line()
    return cancelled, main_button(text, px(width), enabled=enabled)


def begin_modal(name: str, width: float, at: float, *, pivot: float = 0.5, padding: tuple[float, float]) -> bool:
    """Opens a modal dialog and begins it: where this is True, imgui.end_popup() must follow.

    width, padding: in units; as wide as the window at most. at: where its `pivot` is, 0 (the window's top) … 1 (its foot).
    """
    size = imgui.get_io().display_size
    if not imgui.is_popup_open(name):
        imgui.open_popup(name)
    imgui.set_next_window_pos(ImVec2(0.5 * size.x, at * size.y), imgui.Cond_.always, ImVec2(0.5, pivot))
    imgui.set_next_window_size(ImVec2(min(px(width), size.x - px(32)), 0))
    flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_saved_settings
    with style(window_padding=padding):
        return imgui.begin_popup_modal(name, None, flags | imgui.WindowFlags_.always_auto_resize)[0]


def pressed_here(key: imgui.Key) -> bool:
    """Whether a key was pressed that this window may take: not the one whose press has just brought it up."""
    return imgui.is_key_pressed(key, False) and not imgui.is_window_appearing()


def confirmed() -> bool:
    """Whether Enter was pressed for the window as a whole: not for the widget in it that the keyboard was moved to."""
    return pressed_here(imgui.Key.enter) and not imgui.get_io().nav_visible


Modal = Literal["", "message", "path", "open", "make", "export"]


def in_front(app: App) -> Modal:
    """The dialog in front, "" for none. One at a time: two modal windows would push each other away in every frame."""
    dialogs: list[tuple[Modal, object]] = [
        ("message", app.messages.dialogs or None), ("path", app.file_request), ("open", app.open_prompt),
        ("make", app.making.plan), ("export", app.exporting.preview), ("", True),
    ]  # fmt: skip
    return next(name for name, dialog in dialogs if dialog is not None)


CARD_WIDTH, CARD_MARGIN, BUTTON_WIDTH = 372.0, 16.0, 86.0


@contextmanager
def corner_card(name: str, box: Box) -> Iterator[None]:
    """A window as high as what is in it, at the lower left of the viewport's box; name: as imgui names windows."""
    width = min(px(CARD_WIDTH), box[2] - 2 * px(CARD_MARGIN))
    at = ImVec2(box[0] + px(CARD_MARGIN), box[1] + box[3] - px(CARD_MARGIN))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0.0, 1.0))
    imgui.set_next_window_size(ImVec2(width, 0))
    kinds = imgui.WindowFlags_
    flags = kinds.no_decoration | kinds.no_saved_settings | kinds.no_nav | kinds.no_docking
    flags |= kinds.no_focus_on_appearing | kinds.always_auto_resize
    with style(window_padding=(16, 14)), coloured(window_bg=theme.CARD):
        imgui.begin(name, None, flags)
    yield
    imgui.end()


def titled_button(title: str, action: str, note: str = "") -> bool:
    """The first row of such a card: a title, a note behind it, and a button at the right; whether that was pressed."""
    width = px(BUTTON_WIDTH)
    taken = width + px(8) + (imgui.calc_text_size(note).x + px(10) if note else 0.0)
    imgui.align_text_to_frame_padding()
    with font(theme.fonts.bold, 16.0):
        write(elided(title, imgui.get_content_region_avail().x - taken))
    if note:
        imgui.same_line(0, px(10))
        write(note, theme.ACCENT)
    imgui.same_line()
    imgui.set_cursor_pos_x(imgui.get_window_width() - px(16) - width)
    return button(action, width)
