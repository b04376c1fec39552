"""snerg.train, bake, evaluate and show refuse wrong arguments before any work, in one line that names the argument."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import snerg

RUN = Path(__file__).parents[1] / "data" / "runs"


@pytest.mark.parametrize(
    ("function", "given", "arguments", "where"),
    [
        (snerg.read_photographs, (RUN,), {"downscale": 0}, "downscale"),
        (snerg.train, ("PHOTOS", "out"), {}, "photographs"),
        (snerg.train, ("PHOTOS", "out"), {"preset": "fast"}, "preset"),
        (snerg.show, (None,), {"size": "large"}, "size"),
        (snerg.evaluate, ("scene.zip", "PHOTOS"), {}, "photographs"),
        (snerg.bake, ("run", "out.zip"), {"method": "mesh"}, "method"),
        (snerg.bake, ("run", "out.zip"), {"resolution": 100.5}, "resolution"),
        (snerg.bake, ("run", "out.zip"), {"quality": "best"}, "quality"),
        (snerg.bake, ("run", "out.zip"), {"codec": "gif"}, "codec"),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(
    function: Callable[..., Any], given: tuple[Any, ...], arguments: dict[str, Any], where: str
) -> None:
    with pytest.raises(snerg.SnergError) as refused:
        function(*given, **arguments)
    assert refused.value.where == where and "\n" not in str(refused.value)
