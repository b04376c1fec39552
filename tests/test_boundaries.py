"""Which package may import which (docs/architecture.md, "The packages"), and other rules for the layout of the code."""

import ast
import re
import subprocess
import sys
from fnmatch import fnmatch
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHIPPED = {"console", "scenepack", "training", "baker", "viewer"}
PACKAGES = SHIPPED | {"snerg", "tools"}
MAY_IMPORT = {
    "console": set(),
    "scenepack": {"console"},
    "training": {"console", "scenepack.cameras", "scenepack.constants", "scenepack.contraction"},
    "baker": {"console", "scenepack", "training", "viewer.rendering", "viewer.benchmark", "viewer.web"},
    "viewer": {"console", "scenepack", "training.scenes"},
    "snerg": SHIPPED,
    "tools": SHIPPED | {"tests"},
}
JAX = {"jax", "jaxlib", "optax"}
MOST_LINES_OF_A_FILE, MOST_LINES_OF_A_FUNCTION = 600, 80
# Modules that draw with Dear ImGui. What a feature knows and does is in its other modules, which need no window.
PANELS = "viewer.features.*panel"
DRAWING = (PANELS, "viewer.interface.*", "viewer.core.theme", "viewer.core.widgets", "viewer.core.screen")


def modules(folder: str) -> list[Path]:
    return sorted((ROOT / folder).rglob("*.py"))


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported_names(path: Path, *, for_types: bool = True) -> set[str]:
    """Every module that a file imports, at its top or later, as dotted names. for_types: also for type checking alone."""
    names: set[str] = set()
    body = tree_of(path).body
    if not for_types:
        body = [node for node in body if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")]
    for node in (inner for outer in body for inner in ast.walk(outer)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            # `from training import scenes` means training.scenes; `from x import y` may name a value of x
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_a_package_imports_only_what_the_plan_allows(package: str) -> None:
    assert modules(package)
    for path in modules(package):
        for name in imported_names(path):
            other = name.split(".")[0]
            if other in (PACKAGES | {"tests"}) - {package}:  # installed packages may not need tools or tests
                allowed = any(name == ok or name.startswith(ok + ".") for ok in MAY_IMPORT[package])
                assert allowed, f"{path.relative_to(ROOT)} imports {name}"


def test_the_viewer_and_what_reads_photographs_do_not_import_jax_nor_load_it_indirectly() -> None:
    for package in ("console", "scenepack", "viewer", "snerg", "training/scenes", "training/posing"):
        for path in modules(package):
            assert not {name.split(".")[0] for name in imported_names(path)} & JAX, path.relative_to(ROOT)
    without = "snerg, scenepack, training.scenes, training.posing.find, viewer.commands.bench, viewer.commands.view"
    code = f"import {without}, sys; sys.exit(sum(name in sys.modules for name in {sorted(JAX)}))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=120).returncode == 0


def test_one_file_imports_glfw_panels_imgui_and_only_the_viewer_moderngl() -> None:
    users: dict[str, set[str]] = {"glfw": set(), "imgui_bundle": set(), "moderngl": set()}
    for package in PACKAGES:
        for path in modules(package):
            for name in {name.split(".")[0] for name in imported_names(path)} & set(users):
                users[name].add(".".join(path.relative_to(ROOT).with_suffix("").parts))
    assert users["glfw"] == {"viewer.window.window"}
    elsewhere = {name for name in users["imgui_bundle"] if not any(fnmatch(name, pattern) for pattern in DRAWING)}
    assert elsewhere == users["glfw"] != users["imgui_bundle"]  # it brings the GLFW library, which all must share
    window = imported_names(ROOT / "viewer/window/window.py")
    assert [name for name in window if name.startswith("imgui_bundle")] == ["imgui_bundle"]  # and no more of it
    assert users["moderngl"] and all(name.startswith(("viewer.", "tools.fuzz.")) for name in users["moderngl"])


def names_of_modules() -> dict[str, Path]:
    """All of ours by dotted name; a folder by its __init__."""
    paths = [path for package in sorted(PACKAGES) for path in modules(package)]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}


@cache
def graph(*, for_types: bool = True) -> dict[str, set[str]]:
    """Which module of ours imports which: at its top, within a function, or (for_types) for type checking."""
    found = names_of_modules()
    arrows: dict[str, set[str]] = {}
    for module, path in found.items():
        names = imported_names(path, for_types=for_types)
        # `from x import y` may name the module x.y, or a value of x
        meant = {name if name in found else name.rpartition(".")[0] for name in names}
        arrows[module] = (meant & set(found)) - {module}
    return arrows


# From top to bottom, each may import those below it; not counted is what only type checking imports. Modules at the baker's root
# are at the bottom: they know nothing of its packages.
FLOORS = {
    "viewer": [
        "viewer.commands",
        "viewer.window",
        "viewer.interface",
        PANELS,
        "viewer.web",
        "viewer.benchmark",
        "viewer.app",
        "viewer.features",
        "viewer.core",
        "viewer.desktop",
        "viewer.rendering",
    ],
    "baker": ["baker.commands", "baker.reports", "baker.baking", "baker.tuning", "baker"],
}


def floor_of(module: str, floors: list[str]) -> int | None:
    """The place, from the top, of the longest entry that holds the module; None where none does."""
    holding = [floor for floor in floors if fnmatch(module, floor) or module.startswith(floor + ".")]
    return floors.index(max(holding, key=len)) if holding else None


@pytest.mark.parametrize("package", sorted(FLOORS))
def test_within_a_package_arrows_run_downwards(package: str) -> None:
    upwards = []
    for module, imported in graph(for_types=False).items():
        here = floor_of(module, FLOORS[package])
        for other in imported:
            there = floor_of(other, FLOORS[package])
            if here is not None and there is not None and there < here:
                upwards.append(f"{module} -> {other}")
    assert not upwards
    homeless = [name for name in graph() if name.startswith(package + ".") and floor_of(name, FLOORS[package]) is None]
    assert not [name for name in homeless if names_of_modules()[name].name != "__init__.py"]


def test_only_commands_know_the_command_line_and_no_library_imports_a_command() -> None:
    for module, imported in graph().items():
        if ".commands" in module or not module.startswith(("baker", "viewer")):
            continue
        assert not [name for name in imported if re.match(r"\w+\.commands\b", name)], module
        names = imported_names(names_of_modules()[module])
        assert not names & {"console.run_command", "console.command_line.run_command", "tyro", "argparse"}, module


def test_no_modules_import_one_another_in_a_circle() -> None:
    """Imports for type checking alone do not count: the features of the viewer take the App, which holds them."""
    TopologicalSorter(graph(for_types=False)).prepare()  # CycleError where there is one


def test_no_function_and_no_file_is_too_long() -> None:
    """Of a function counts what follows its docstring: the parameters of a command are its options, with their help."""
    long = {}
    for module, path in (names_of_modules() | {str(path): path for path in modules("tests")}).items():
        if (lines := len(path.read_text(encoding="utf-8").splitlines())) > MOST_LINES_OF_A_FILE:
            long[module] = lines
        functions = (
            node for node in ast.walk(tree_of(path)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        )
        for node in functions:
            body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
            lines = body[-1].end_lineno - body[0].lineno + 1  # type: ignore[operator]
            if lines > MOST_LINES_OF_A_FUNCTION:
                long[f"{module}.{node.name}"] = lines
    assert not long


def decoders_left_to_guess(tree: ast.AST) -> list[int]:
    """Lines that open pictures with Pillow or films with PyAV and leave it to the content which format that is."""
    guarded = set()
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        writes = any(isinstance(value, ast.Constant) and value.value == "w" for value in call.args[1:2])
        if writes or {keyword.arg for keyword in call.keywords} & {"formats", "format"}:
            guarded.add(id(call.func))
    opening = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "open"]
    libraries = ("Image", "PIL.Image", "av", "_av()", "self._av")
    return [node.lineno for node in opening if ast.unparse(node.value) in libraries and id(node) not in guarded]


def test_whoever_opens_a_picture_or_a_film_names_the_formats_it_expects() -> None:
    """Pillow starts Ghostscript for PostScript, and FFmpeg opens sockets for session descriptions, whatever the name."""
    for package in (*sorted(PACKAGES), "scripts"):
        for path in modules(package):
            tree = tree_of(path)
            assert not decoders_left_to_guess(tree), path.relative_to(ROOT)
            imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
            names = {(node.module, alias.name, alias.asname) for node in imported for alias in node.names}
            renamed = {name for name in names if name[:2] in {("PIL", "Image"), ("PIL.Image", "open"), ("av", "open")}}
            assert renamed <= {("PIL", "Image", None)}, f"{path.relative_to(ROOT)} hides where it opens pictures"


@pytest.mark.parametrize("code", ["Image.open(path)", "map(Image.open, paths)", "_av().open(file)", "av.open(p, 'r')"])
def test_a_decoder_left_to_guess_is_found(code: str) -> None:
    assert decoders_left_to_guess(ast.parse(code)) == [1]
