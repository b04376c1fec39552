"""Which room may import which (CONTRIBUTING, "The plan of the house"), checked on what really gets imported."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = {"console", "scenepack", "training", "baker", "viewer"}
MAY_IMPORT = {
    "console": set(),
    "scenepack": {"console"},
    "training": {"console", "scenepack.constants"},
    "baker": {"console", "scenepack", "training", "viewer"},
    "viewer": {"console", "scenepack", "training.scenes", "training.presets"},
}
JAX = {"jax", "jaxlib", "optax"}


def modules(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


def imported_names(path: Path) -> set[str]:
    """Every module that a file imports, at its top or later, as dotted names."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            # `from training import scenes` means training.scenes; `from x import y` may name a value of x
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_a_room_imports_only_what_the_plan_allows(room: str) -> None:
    assert modules(room)
    for path in modules(room):
        for name in imported_names(path):
            other = name.split(".")[0]
            if other in ROOMS - {room}:
                allowed = any(name == ok or name.startswith(ok + ".") for ok in MAY_IMPORT[room])
                assert allowed, f"{path.relative_to(ROOT)} imports {name}"


@pytest.mark.parametrize("room", ["console", "scenepack", "viewer", "training/scenes"])
def test_no_jax_where_the_viewer_can_reach(room: str) -> None:
    for path in modules(room):
        assert not {name.split(".")[0] for name in imported_names(path)} & JAX, path.relative_to(ROOT)


@pytest.mark.parametrize(
    "module",
    [
        "console",
        "scenepack",
        "training.scenes",
        "training.presets",
        "viewer.rendering.offscreen",
        "viewer.commands.bench",
        "viewer.commands.view",
    ],
)
def test_importing_it_does_not_load_jax_even_indirectly(module: str) -> None:
    code = f"import {module}, sys; sys.exit(sum(name in sys.modules for name in {sorted(JAX)}))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=120).returncode == 0


def test_one_file_imports_glfw_one_folder_imgui_and_only_the_renderers_room_moderngl() -> None:
    users: dict[str, set[str]] = {"glfw": set(), "imgui_bundle": set(), "moderngl": set()}
    for room in ROOMS:
        for path in modules(room):
            for name in {name.split(".")[0] for name in imported_names(path)} & set(users):
                users[name].add(str(path.relative_to(ROOT)))
    assert users["glfw"] == {"viewer/window/window.py"}
    assert users["imgui_bundle"] and all(path.startswith("viewer/panels/") for path in users["imgui_bundle"])
    assert users["moderngl"] and all(path.startswith("viewer/") for path in users["moderngl"])


def test_shaders_is_glsl_only() -> None:
    assert {path.suffix for path in (ROOT / "shaders").iterdir() if path.is_file()} <= {".glsl", ".vert", ".frag"}


def decoders_left_to_guess(tree: ast.AST) -> list[int]:
    """Lines that open pictures with Pillow or films with PyAV and leave it to the content which format that is."""
    guarded = {
        id(node.func)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and (
            {keyword.arg for keyword in node.keywords} & {"formats", "format"}
            or any(isinstance(value, ast.Constant) and value.value == "w" for value in node.args[1:2])
        )
    }
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr == "open"
        and ast.unparse(node.value) in ("Image", "PIL.Image", "av", "_av()", "self._av")
        and id(node) not in guarded
    ]


def test_whoever_opens_a_picture_or_a_film_names_the_formats_it_expects() -> None:
    """Pillow starts Ghostscript for PostScript, and FFmpeg opens sockets for session descriptions, whatever the name."""
    for room in (*sorted(ROOMS), "scripts"):
        for path in modules(room):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            assert not decoders_left_to_guess(tree), path.relative_to(ROOT)
            imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
            names = {(node.module, alias.name, alias.asname) for node in imported for alias in node.names}
            renamed = {name for name in names if name[:2] in {("PIL", "Image"), ("PIL.Image", "open"), ("av", "open")}}
            assert renamed <= {("PIL", "Image", None)}, f"{path.relative_to(ROOT)} hides where it opens pictures"


@pytest.mark.parametrize("code", ["Image.open(path)", "map(Image.open, paths)", "_av().open(file)", "av.open(p, 'r')"])
def test_a_decoder_left_to_guess_is_found(code: str) -> None:
    assert decoders_left_to_guess(ast.parse(code)) == [1]
