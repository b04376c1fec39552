"""Names in other scripts are shown with the system's fonts, not as boxes."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from scenepack import save_pack
from tests.viewer.window.running import picture_of_view
from viewer.core import theme
from viewer.core.log import Dialog
from viewer.core.theme import FontFile, chosen_fonts, load_fonts

JAPANESE = "日本棚"


def needs_japanese() -> None:
    """Skips where no font has Japanese letters."""
    if not shutil.which("fc-list"):
        pytest.skip("fc-list is not installed: apt-get install fontconfig")
    command = ["fc-list", ":charset=65e5 68da", "file"]
    listed = subprocess.run(command, capture_output=True, text=True, timeout=60).stdout
    if not any(line.rstrip(": ").endswith(theme.SUFFIXES) for line in listed.splitlines()):
        pytest.skip("no font with Japanese letters is installed (such as fonts-noto-cjk or fonts-droid-fallback)")


def picture_of_name(name: str, display: str, pack, folder: Path, **environment: str) -> np.ndarray:
    """The window's upper bar with a pack of that name open, int [40, 60, 3]."""
    save_pack(pack, folder / "packs" / name)
    picture = picture_of_view(folder, folder / "packs" / name, DISPLAY=display, PYTHONUTF8="1", **environment)
    return picture[4:44, 100:160]


@pytest.mark.slow
def test_a_japanese_name_is_shown_in_the_real_window(display, pack, tmp_path):
    needs_japanese()
    one = picture_of_name(JAPANESE, display, pack, tmp_path)
    other = picture_of_name(JAPANESE[::-1], display, pack, tmp_path)
    assert np.abs(one - other).max() > 60  # boxes are the same whatever they stand for


@pytest.mark.slow
def test_without_any_font_the_window_opens_all_the_same(display, pack, tmp_path):
    (tmp_path / "fonts.conf").write_text("<fontconfig></fontconfig>")
    bar = picture_of_name(JAPANESE, display, pack, tmp_path, FONTCONFIG_FILE=str(tmp_path / "fonts.conf"))
    assert bar.max() > 150


def test_letters_that_were_boxes_are_drawn_once_their_font_is_there(offscreen, app, tmp_path):
    needs_japanese()
    ui = offscreen(app, size=(600, 300))
    fonts = ui.ui.fonts
    app.messages.dialogs.append(Dialog(JAPANESE, JAPANESE * 3))
    ui.settle()
    boxes = ui.picture()
    assert "漢" in fonts.missing and "A" not in fonts.missing
    (tmp_path / "broken.ttf").write_bytes(b"no font")
    for file in [FontFile(tmp_path / "broken.ttf"), FontFile(tmp_path / "gone.ttf"), *load_fonts(fonts.missing)]:
        fonts.add(file)
    imgui.set_current_context(ui.ui.context)
    assert fonts.bold.is_glyph_in_font(ord("日")) and "漢" not in fonts.missing
    app.touch()
    ui.settle()
    assert np.abs(ui.picture().astype(int) - boxes).max() > 100


LISTED = (
    "/fonts/Latin.ttf\t0\tFalse\t20-7e a0-ff\n"
    "/fonts/Emoji.ttf\t0\tTrue\t2605 3042\n"
    "/fonts/Old.pfb\t0\tFalse\t3042\n"
    "/fonts/Kana.ttc\t65538\tFalse\t3041-3096 6f22\n"
    "/fonts/Same.ttf\t0\tFalse\t3042\n"
    "/fonts/Star.otf\t0\tFalse\t2605\n"
)


def test_fonts_are_taken_for_the_letters_that_none_before_has():
    expected = [FontFile(Path("/fonts/Kana.ttc"), 2), FontFile(Path("/fonts/Star.otf"), 0)]
    assert chosen_fonts(LISTED, "あ漢★") == expected
    assert chosen_fonts(LISTED, "") == [] == chosen_fonts("", "あ") == chosen_fonts("nonsense\n\t\t\n", "あ")
