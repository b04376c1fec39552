"""snerg.train, bake, evaluate and show refuse wrong arguments before any work, in one line that names the argument."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import snerg
from tests.stored_runs import STORED
from tests.training.test_captures import circle, write_transforms


@pytest.mark.parametrize(
    ("function", "given", "arguments", "where"),
    [
        (snerg.read_photographs, (STORED,), {"downscale": 0}, "downscale"),
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


def test_a_remedy_names_an_argument_as_python_does_and_keeps_whole_commands(tmp_path: Path) -> None:
    scene = write_transforms(tmp_path / "scene", circle())
    with pytest.raises(snerg.SnergError, match=r"leave out masks$"):
        snerg.read_photographs(scene, masks=True)
    with pytest.raises(snerg.SnergError, match=r"snerg-train SCENE --out RUN$"):
        snerg.bake(tmp_path / "none", tmp_path / "out.zip")
