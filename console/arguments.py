"""Words of the command line that several commands understand."""

import re

from console.errors import UserError

MAX_SIDE = 16384


def parse_size(text: str, where: str = "--size", *, least: int = 1) -> tuple[int, int]:
    """ "800x600" as (width, height), both at least `least`. UserError for anything else."""
    match = re.fullmatch(r"(\d+)[x×](\d+)", text.strip())
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(least <= side <= MAX_SIDE for side in size):
        sides = f", sides of {least} to {MAX_SIDE}" if match else ""
        raise UserError(
            "is not a size in pixels", where=where, expected=f"WxH such as 800x600{sides}", found=repr(text)
        )
    return size


def parse_numbers(text: str, count: int, where: str) -> tuple[float, ...]:
    """ "1,2,3" as `count` finite numbers. UserError for anything else."""
    try:
        numbers = tuple(float(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(abs(number) < 1e30 for number in numbers):
        example = ",".join("123456"[:count])
        raise UserError(
            "is not a list of numbers", where=where, expected=f"{count} such as {example}", found=repr(text)
        )
    return numbers


def parse_point(text: str, where: str) -> tuple[float, float, float]:
    """ "x,y,z" as three finite numbers. UserError for anything else."""
    x, y, z = parse_numbers(text, 3, where)
    return x, y, z


def parse_corners(text: str, where: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """ "x0,y0,z0,x1,y1,z1" as two corners. UserError for anything else."""
    x0, y0, z0, x1, y1, z1 = parse_numbers(text, 6, where)
    return (x0, y0, z0), (x1, y1, z1)


def require_in_range(where: str, value: float, low: float, high: float) -> None:
    """UserError where the value of an option is not one of low … high."""
    if not low <= value <= high:
        raise UserError("is out of range", where=where, expected=f"{low:g} to {high:g}", found=value)
