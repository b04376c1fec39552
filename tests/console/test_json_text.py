"""JSON that nobody writes by mistake: whoever reads it says no in one line, and never with a traceback."""

from __future__ import annotations

import dataclasses
import json

import pytest

from console import UserError
from console.json_text import MOST_BYTES, parse_json
from training.config import TINY, from_json


def test_a_value_comes_back_as_it_was_written() -> None:
    document = {"whole": 123456789012345678, "float": 0.1, "text": "日本語", "list": [1, -2.5, None, True]}
    assert parse_json(json.dumps(document)) == document
    assert parse_json(b"\xef\xbb\xbf" + json.dumps(document).encode()) == document
    assert type(parse_json("17")) is int and parse_json("9" * 30) == 1e30


def test_more_than_anybody_writes_is_not_parsed() -> None:
    with pytest.raises(ValueError, match="16 MiB"):
        parse_json(b" " * (MOST_BYTES + 1))


@pytest.mark.parametrize(
    ("name", "value"),
    [("batch_size", -1), ("log_every", 0), ("seed", 10**20), ("steps", -5), ("minutes", float("nan")), ("nerf.width", 0),
     ("multires.occupancy", 0), ("multires.view_octaves", -1), ("multires.steps_from", [0.1, float("nan")]),
     ("nerf.first_rate", -1.0), ("checkpoint_every", 0), ("nerf.depth", 2.5), ("method", "magic")],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused_by_name(name: str, value: object) -> None:
    document = dataclasses.asdict(TINY)
    inner = document
    for part in name.split(".")[:-1]:
        inner = inner[part]
    inner[name.split(".")[-1]] = value
    with pytest.raises(UserError, match=name.split(".")[-1].replace("_", ".")):
        from_json(type(TINY), document, "config.json")
