"""Settings from a command line or a config.json: of the declared types, and in a range that means something."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from typing import Any

from console import UserError

LARGEST_WHOLE = 2**32 - 1  # seeds are 32 bits, and so are the counts that a GPU takes
AT_LEAST_ONE = {
    "batch_size", "log_every", "checkpoint_every", "depth", "width", "coarse_samples", "fine_samples", "render_rays",
    "query_points", "samples_per_step", "resolutions",
    "occupancy", "steps_across",
}  # fmt: skip


def from_json(cls: type, values: Mapping[str, Any], where: str) -> Any:
    """The inverse of dataclasses.asdict. Keys that are gone and values that make no sense are refused, keys that are new take
    their defaults. where: the file.
    """
    if not isinstance(values, Mapping):
        raise UserError("settings are no object", where=where, expected="{…}", found=type(values).__name__)
    hints = typing.get_type_hints(cls)
    if unknown := sorted(set(values) - set(hints)):
        remedy = "the run was made by another version of snerg"
        raise UserError("unknown settings: " + ", ".join(unknown), where=where, remedy=remedy)
    made = {}
    for name, value in values.items():
        if dataclasses.is_dataclass(hints[name]):
            made[name] = from_json(hints[name], value, f"{where} {name}")
        else:
            made[name] = tuple(value) if isinstance(value, list) else value
    config = cls(**made)
    require_valid(config, where)
    return config


def require_valid(config: Any, where: str | None = None, prefix: str = "") -> None:
    """UserError, naming the setting, where a value of a dataclass (nested ones included) has another type, is negative, not
    finite, or zero where nothing can be done with that. where: the file; options of the command line without it.
    """
    hints = typing.get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value, hint, name = getattr(config, field.name), hints[field.name], prefix + field.name
        if dataclasses.is_dataclass(value) and dataclasses.is_dataclass(hint):
            require_valid(value, where, f"{name}.")
            continue
        expected = _expected_instead(value, hint, 1 if field.name in AT_LEAST_ONE else 0)
        if expected:
            found = repr(value)
            raise UserError(
                "makes no sense" if where is None else f"{name} makes no sense",
                where="--" + name.replace("_", "-") if where is None else where,
                expected=expected,
                found=found if len(found) <= 40 else f"{found[:37]}…",
            )


def _expected_instead(value: Any, hint: Any, least: int) -> str | None:
    """What is expected in place of `value`; None where it will do."""
    origin, choices = typing.get_origin(hint), typing.get_args(hint)
    if dataclasses.is_dataclass(hint):
        return "an object"
    if origin is typing.Literal:
        return None if value in choices and isinstance(value, str) else f"one of {', '.join(choices)}"
    if origin in (types.UnionType, typing.Union):
        expected = [_expected_instead(value, choice, least) for choice in choices]
        return None if None in expected else expected[0]
    if origin is tuple:
        if not isinstance(value, tuple):
            return "a list"
        return next((text for item in value if (text := _expected_instead(item, choices[0], least))), None)
    if hint is type(None):
        return None if value is None else "nothing"
    if hint is int:
        fits = type(value) is int and least <= value <= LARGEST_WHOLE
        return None if fits else f"a whole number from {least} to {LARGEST_WHOLE}"
    if hint is float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        return None if number and math.isfinite(value) and value >= 0 else "a number, not below 0"
    return None if isinstance(value, hint) else hint.__name__
