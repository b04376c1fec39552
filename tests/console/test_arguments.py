"""Words of the command line: sizes and numbers, and the one line that tells what is wrong with them."""

from __future__ import annotations

import pytest

from console import UserError
from console.arguments import parse_point, parse_size


def test_a_size_is_width_by_height() -> None:
    assert parse_size("1280x800") == parse_size(" 1280×800 ") == (1280, 800)


@pytest.mark.parametrize("text", ["", "800", "800x", "0x10", "-8x8", "8x8x8", "20000x10", "8.5x8"])
def test_what_is_no_size_is_told_in_one_line(text: str) -> None:
    with pytest.raises(UserError, match=r"--export-size: .*WxH such as 800x600"):
        parse_size(text, "--export-size")


def test_a_size_may_have_a_least_side() -> None:
    assert parse_size("64x64", least=64) == (64, 64)
    with pytest.raises(UserError, match="sides of 64 to 16384"):
        parse_size("63x64", least=64)


def test_a_point_is_three_finite_numbers() -> None:
    assert parse_point("1,-2.5,3e2", "--eye") == (1.0, -2.5, 300.0)
    with pytest.raises(UserError, match="3 such as 1,2,3"):
        parse_point("1,2,inf", "--eye")
