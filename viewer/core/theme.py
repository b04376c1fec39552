"""Colours, spacing and fonts. Lengths are in window units at 100 %; `apply` multiplies them on dense displays.

Letters that our fonts lack (Japanese, Arabic, Thai and so on) are taken from the system. fontconfig tells where those are (Linux
and its like), in the order that suits the user's language; Windows and macOS keep theirs in known places. A font is taken for the
letters it brings, so that few are; see SAMPLES.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import imgui_bundle
from imgui_bundle import ImVec2, ImVec4, imgui

FONT_SIZE = 15.0
SMALL, LARGE, HUGE = 13.0, 20.0, 34.0

_FONTS = Path(imgui_bundle.__file__).parent / "assets" / "fonts"


# By theme, what each name below stands for. base: behind everything; card: boxes on a panel; control: what can be pressed;
# deep: behind text that is chosen; on-accent: text on the accent.
PALETTES: dict[str, dict[str, str]] = {
    "dark": {
        "base": "#0d1117", "panel": "#131922", "card": "#1a212c", "control": "#232c39", "control-hot": "#2d3848",
        "line": "#273140", "text": "#e6ebf2", "muted": "#8f9bad", "faint": "#7e8b9d", "accent": "#45d0bd", "deep": "#1f8f82",
        "on-accent": "#06211d", "good": "#6fd08c", "warn": "#f2b866", "bad": "#f2777a", "blue": "#6cb2f5",
    },
    "light": {
        "base": "#dfe4eb", "panel": "#eef1f5", "card": "#ffffff", "control": "#e6eaf0", "control-hot": "#d5dce6",
        "line": "#c6ced9", "text": "#18202b", "muted": "#465263", "faint": "#525e6e", "accent": "#0a776c", "deep": "#7fcabf",
        "on-accent": "#ffffff", "good": "#1b7a40", "warn": "#8a5000", "bad": "#bb2b33", "blue": "#1f6fbf",
    },
}  # fmt: skip
THEMES = tuple(PALETTES)
BASE, PANEL, CARD, CONTROL, CONTROL_HOT, LINE = "base", "panel", "card", "control", "control-hot", "line"
TEXT, MUTED, FAINT = "text", "muted", "faint"
ACCENT, ACCENT_DEEP, ON_ACCENT = "accent", "deep", "on-accent"
GOOD, WARN, BAD, BLUE = "good", "warn", "bad", "blue"
_palette = PALETTES["dark"]

# By colour, what imgui draws in it, by its own names; with opacity where that is not 1.
USES = {
    BASE: "docking_empty_bg",
    PANEL: "window_bg title_bg title_bg_active title_bg_collapsed tab tab_dimmed",
    CARD: "child_bg popup_bg tab_selected tab_dimmed_selected",
    CONTROL: "frame_bg button",
    CONTROL_HOT: "frame_bg_hovered frame_bg_active tab_hovered button_hovered header_hovered resize_grip_hovered scrollbar_grab",
    LINE: "border separator",
    TEXT: "text",
    MUTED: "scrollbar_grab_active",
    FAINT: "text_disabled scrollbar_grab_hovered",
    ACCENT: "resize_grip_active separator_active check_mark nav_cursor plot_histogram",
    ACCENT_DEEP: "separator_hovered button_active header_active",
}
TRANSLUCENT = {
    "docking_preview": (ACCENT, 0.35),
    "resize_grip": (CONTROL_HOT, 0.0),
    "scrollbar_bg": (PANEL, 0.0),
    "slider_grab": (ACCENT, 0.55),  # the number is read through it
    "slider_grab_active": (ACCENT, 0.8),
    "header": (ACCENT_DEEP, 0.55),
    "text_selected_bg": (ACCENT_DEEP, 0.6),
    "modal_window_dim_bg": (BASE, 0.65),
}
# By imgui's names, what differs from its own style; width and height, or one length.
LENGTHS: dict[str, float | tuple[float, float]] = {
    "window_padding": (16, 14), "frame_padding": (10, 6), "item_spacing": (8, 8), "item_inner_spacing": (8, 6),
    "cell_padding": (6, 4), "scrollbar_size": 9, "grab_min_size": 12, "docking_separator_size": 3,
    "window_rounding": 10, "popup_rounding": 10, "child_rounding": 10,
    "frame_rounding": 6, "grab_rounding": 6, "scrollbar_rounding": 6, "tab_rounding": 6,
    "popup_border_size": 1, "separator_text_border_size": 1,
    **dict.fromkeys(("window_border_size", "child_border_size", "frame_border_size"), 0),
    **dict.fromkeys(("tab_bar_border_size", "tab_bar_overline_size", "tab_border_size"), 0),
    "tab_close_button_min_width_selected": -1,  # always seen
    "window_title_align": (0.5, 0.5),  # shares of the title bar
}  # fmt: skip


def rgb(code: str, alpha: float = 1.0) -> ImVec4:
    """A name above, in the theme of the moment, or "#rrggbb", as imgui wants it."""
    code = _palette.get(code, code)
    r, g, b = (int(code[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return ImVec4(r, g, b, alpha)


def packed(code: str, alpha: float = 1.0) -> int:
    """A name above, or "#rrggbb", as draw lists want it."""
    return imgui.color_convert_float4_to_u32(rgb(code, alpha))


class Fonts:
    """regular, bold and mono; icons of Font Awesome are merged into the first two. Made once per imgui context.

    Glyphs are drawn into the atlas when they are first seen, so that fonts of many thousand letters cost only their file.
    """

    def __init__(self) -> None:
        atlas = imgui.get_io().fonts
        self.regular = self._with_icons(atlas, "Roboto/Roboto-Regular.ttf")
        self.bold = self._with_icons(atlas, "Roboto/Roboto-Bold.ttf")
        self.mono = atlas.add_font_from_file_ttf(str(_FONTS / "Inconsolata-Medium.ttf"), FONT_SIZE)

    @property
    def missing(self) -> str:
        """The letters of SAMPLES that cannot be shown."""
        return "".join(letter for letter in SAMPLES if not self.has(letter))

    def has(self, letters: str) -> bool:
        return all(self.regular.is_glyph_in_font(ord(letter)) for letter in letters)

    def add(self, file: FontFile) -> None:
        """Takes the letters that are missing from another font."""
        for font in (self.regular, self.bold):
            merged = imgui.ImFontConfig()
            merged.merge_mode, merged.dst_font, merged.font_no = True, font, file.number
            with contextlib.suppress(RuntimeError):  # a font that is broken, or of a kind that imgui does not read
                imgui.get_io().fonts.add_font_from_file_ttf(str(file.path), FONT_SIZE, merged)

    @staticmethod
    def _with_icons(atlas: imgui.ImFontAtlas, name: str) -> imgui.ImFont:
        font = atlas.add_font_from_file_ttf(str(_FONTS / name), FONT_SIZE)
        merged = imgui.ImFontConfig()
        merged.merge_mode = True
        merged.glyph_offset = ImVec2(0.0, 1.0)
        atlas.add_font_from_file_ttf(str(_FONTS / "Font_Awesome_6_Free-Solid-900.otf"), 0.87 * FONT_SIZE, merged)
        return font


fonts: Fonts  # those of the imgui context that is drawn now; Ui sets them


def apply(name: str, scale: float) -> None:
    """Draws in a theme, on a display whose units are `scale` times denser than usual. An unknown name is the dark one."""
    global _palette
    _palette = PALETTES.get(name, PALETTES["dark"])
    style = imgui.Style()  # a new one: scale_all_sizes multiplies also what is not set below
    style.font_size_base = FONT_SIZE
    for name, length in LENGTHS.items():
        setattr(style, name, ImVec2(*length) if isinstance(length, tuple) else length)
    style.window_menu_button_position = imgui.Dir.none
    style.scale_all_sizes(scale)
    style.window_border_hover_padding = max(style.window_border_hover_padding, 1.0)  # imgui ends the program at 0
    style.font_scale_dpi = scale
    for code, names in USES.items():
        for name in names.split():
            style.set_color_(getattr(imgui.Col_, name), rgb(code))
    for name, (code, alpha) in TRANSLUCENT.items():
        style.set_color_(getattr(imgui.Col_, name), rgb(code, alpha))
    imgui.get_current_context().style = style


# --- The system's fonts ---

# A letter or two of each script that names and messages may be in.
SAMPLES = "ΩЖəệՀაשעعپअঅਅઅଅஅఅಅഅඅกກཀកကአあ漢汉한ㄅ∑⇒★☐"
SUFFIXES = (".ttf", ".otf", ".ttc", ".otc")
FORMAT = "%{file}\t%{index}\t%{color}\t%{charset}\n"
PATIENCE_S = 30.0  # fontconfig looks through all fonts when it is asked for the first time
LARGEST_BYTES = 64 << 20

WINDOWS = (
    *("segoeui.ttf", "YuGothR.ttc", "msgothic.ttc", "msyh.ttc", "msjh.ttc", "malgun.ttf", "Nirmala.ttc", "Nirmala.ttf"),
    *("LeelawUI.ttf", "mmrtext.ttf", "himalaya.ttf", "ebrima.ttf", "sylfaen.ttf", "seguisym.ttf"),
)
MACOS = (
    *("ヒラギノ角ゴシック W3.ttc", "PingFang.ttc", "Hiragino Sans GB.ttc", "AppleSDGothicNeo.ttc"),
    *("Supplemental/Arial Unicode.ttf", "GeezaPro.ttc", "ArialHB.ttc"),
    *("Kohinoor.ttc", "Thonburi.ttc", "Apple Symbols.ttf"),
)


@dataclass(frozen=True)
class FontFile:
    """A font: its file, and which of those in a collection."""

    path: Path
    number: int = 0


def load_fonts(missing: str) -> list[FontFile]:
    """Fonts that have `missing` letters, the best first, read from the disk once: the window then finds them in memory."""
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):  # fontconfig is not there, or does not answer
        if sys.platform == "win32":
            known = [FontFile(Path(os.environ.get("SYSTEMROOT", "C:/Windows"), "Fonts", name)) for name in WINDOWS]
        elif sys.platform == "darwin":
            known = [FontFile(Path("/System/Library/Fonts", name)) for name in MACOS]
        else:
            command = ["fc-match", "--sort", "--format", FORMAT, "sans-serif"]
            done = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, stdin=subprocess.DEVNULL)
            known = chosen_fonts(done.stdout.decode(errors="replace"), missing)
        found = [font for font in known if font.path.is_file() and font.path.stat().st_size <= LARGEST_BYTES]
        for font in found:
            font.path.read_bytes()
        return found
    return []  # boxes, then


def chosen_fonts(listed: str, missing: str) -> list[FontFile]:
    """Of what fc-match lists (see FORMAT), the fonts to take, each for the letters that none before has."""
    chosen, left = [], set(missing)
    for line in listed.splitlines():
        path, index, colour, charset = (line.split("\t") + [""] * 4)[:4]
        if not left or colour == "True" or not path.lower().endswith(SUFFIXES):
            continue
        ranges = [[int(end, 16) for end in words.split("-")] for words in charset.split()]  # "3041-3096" or "3041"
        brings = {letter for letter in left if any(ends[0] <= ord(letter) <= ends[-1] for ends in ranges)}
        if brings:
            number = int(index or 0) & 0xFFFF  # the upper half names an instance of a variable font
            chosen.append(FontFile(Path(path), number))
            left -= brings
    return chosen
