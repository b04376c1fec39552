"""Plots: every line is seen in its colour, where its numbers are, below one another in one PNG."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor

from console import UserError, plots
from console.plots import COLOURS, Line, Plot, draw_plots

RISING = Line("rising", [0.0, 50.0, 100.0], [1.0, 2.0, 3.0], marked=True)
FALLING = Line("falling", range(101), [3.0 - i / 50 for i in range(101)])


def pixels_of(picture: np.ndarray, colour: str) -> np.ndarray:
    """(row, column) of the pixels that are just about `colour`."""
    away = np.abs(picture.astype(int) - np.array(ImageColor.getrgb(colour))).max(axis=2)
    return np.argwhere(away < 30)


def drawn(path: Path, *shown: Plot, size: tuple[int, int] = (400, 200)) -> np.ndarray:
    draw_plots(path, shown, size)
    return np.asarray(Image.open(path).convert("RGB"))


@pytest.mark.parametrize("y_axis", ["zero", "data", "log"])
def test_lines_are_drawn_where_their_numbers_are_and_plots_below_one_another(tmp_path: Path, y_axis) -> None:
    below = Plot([FALLING], "below", "x", "y")
    picture = drawn(tmp_path / "new" / "a.png", Plot([RISING, FALLING], "two", "x", "y", y_axis), below)
    assert picture.shape == (600, 600, 3) and len(pixels_of(picture[300:], COLOURS[0])) > 100
    picture = picture[:300]
    up, down = pixels_of(picture, COLOURS[0]), pixels_of(picture, COLOURS[1])
    up = up[up[:, 0] > 100]  # below the legend
    left, right = up[up[:, 1] < 200][:, 0].mean(), up[up[:, 1] > 450][:, 0].mean()
    assert right < left - 30 and len(down) > 100  # rows count from the top


@pytest.mark.parametrize("name", ["not UTF-8 \udcff", "an odd $ sign", "$a_$ and $b^^$", "\\frac", "\N{PILE OF POO}\n"])
def test_any_name_of_a_file_may_be_a_title_and_a_label(tmp_path: Path, name: str) -> None:
    drawn(tmp_path / "a.png", Plot([Line(name, [0, 1], [2, 3]), RISING], name, "x", "y"))


def test_without_matplotlib_the_remedy_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plots.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install matplotlib, or 'snerg\[train\]'"):
        draw_plots(tmp_path / "a.png", [Plot([RISING], "one", "x", "y")])
