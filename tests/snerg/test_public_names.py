"""What is public: documented, quick to import, with the choices of the commands, and wrong arguments are refused at once."""

import dataclasses
import inspect
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import nbclient
import nbformat
import numpy as np
import pytest
from PIL import Image

import snerg
from baker.baking.config import BakePreset, Quality
from scenepack.constants import CodecName
from snerg import _making, _scene
from tests.stored_runs import STORED
from tests.training.test_captures import circle, write_transforms
from training.scenes.presets import BakeablePreset

ROOT = Path(__file__).parents[2]
HEAVY = ("jax", "jaxlib", "numba", "numpy", "glfw", "imgui_bundle", "moderngl", "console", "viewer", "training")
IMPORT_S = 0.3  # of processor time, so that a busy machine does not count
NOTEBOOK = ROOT / "docs/notebooks/first_scene.ipynb"
NOTEBOOKS_PSNR = 20.0  # dB, at least, of 200 steps; a picture of the background alone has 14
ARTICLE = re.compile(r"```python\n(.*?)```", re.S)


def test_every_public_name_is_documented() -> None:
    assert list(snerg.__all__) == sorted(snerg.__all__)
    source = {name: inspect.getsource(sys.modules[name]) for name in sys.modules if name.startswith("snerg._")}
    for name in snerg.__all__:
        thing = getattr(snerg, name)
        assert (inspect.getdoc(thing) or "").strip(), name
        if not isinstance(thing, type):
            continue
        for member, value in vars(thing).items():
            public = not member.startswith("_") or member == "__init__"
            if public and (inspect.isfunction(value) or isinstance(value, property | staticmethod)):
                inner = value.__func__ if isinstance(value, staticmethod) else value
                assert (dataclasses.is_dataclass(thing) and member == "__init__") or inner.__doc__, f"{name}.{member}"
        for field in dataclasses.fields(thing) if dataclasses.is_dataclass(thing) else ():
            if not field.name.startswith("_"):
                pattern = rf"^    {field.name}: [^\n]*\n    \"\"\"\S"
                assert any(re.search(pattern, text, re.M) for text in source.values()), f"{name}.{field.name}"


def test_the_star_import_gives_the_public_names_alone() -> None:
    names: dict[str, object] = {}
    exec("from snerg import *", names)
    assert set(names) - {"__builtins__"} == set(snerg.__all__)
    assert {name for name in vars(snerg) if not name.startswith("_")} <= {*snerg.__all__, "annotations"}


def test_importing_it_is_quick_and_loads_nothing_large() -> None:
    code = (
        "import sys, time; began = time.process_time(); import snerg; print(time.process_time() - began); "
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    seconds, loaded = done.stdout.splitlines()
    assert float(seconds) < IMPORT_S and loaded == "[]", done.stdout + done.stderr


def test_choices_are_those_of_the_commands() -> None:
    assert get_args(_making.Preset) == get_args(BakeablePreset)
    assert set(get_args(_scene.Codec)) == set(get_args(CodecName))
    assert set(get_args(_making.Quality)) == set(get_args(Quality))
    assert set(get_args(_making.Method)) == set(get_args(BakePreset))


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


def test_the_example_of_the_readme_gives_the_picture_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (example,) = ARTICLE.findall(readme)
    assert len(example.splitlines()) <= 10
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})
    made = np.asarray(Image.open(tmp_path / "island.png"), np.int16)
    shown = np.asarray(Image.open(ROOT / "docs/pictures/island.png"), np.int16)
    assert made.shape == shown.shape and np.abs(made - shown).mean() < 0.5  # other drivers round otherwise
    assert sorted(path.name for path in tmp_path.iterdir()) == ["island.png"]


@pytest.mark.slow
def test_the_notebook_makes_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.reads(NOTEBOOK.read_text(encoding="utf-8"), as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "clear its outputs before you commit it"
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 3
    (page,) = (html for output in outputs if "<iframe" in (html := output.get("data", {}).get("text/html", "")))
    assert "Content-Security-Policy" in page
    printed = "".join(output.get("text", "") for output in outputs if output.output_type == "stream")
    assert float(re.findall(r"([\d.]+) dB on 4 photographs", printed)[0]) > NOTEBOOKS_PSNR, printed
    assert {"island.glb", "mine.zip", "photographs", "run"} <= {path.name for path in tmp_path.iterdir()}
