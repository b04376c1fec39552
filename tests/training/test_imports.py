"""The rooms within training/: which may import which, and that nothing imports in a circle or within a function."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# from bottom to top: a module of multires/ may import those before it
MULTIRES = ["config", "settings", "levels", "occupancy", "state", "field", "hull", "saving", "jax_engine", "engines",
            "method"]  # fmt: skip


def imports(path: Path) -> dict[str, bool]:
    """Modules of ours that a file imports, at its top or later and for type checking, too -> whether at its top."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    return {node.module: node in tree.body for node in nodes if node.module and node.module.startswith("training")}


@pytest.mark.parametrize("path", sorted((ROOT / "training/marching").glob("*.py")), ids=lambda path: path.stem)
def test_marching_knows_no_method(path: Path) -> None:
    assert not [name for name in imports(path) if name.startswith(("training.multires", "training.nerf"))]


def test_the_fields_modules_import_downwards_and_at_the_top_alone() -> None:
    folder = ROOT / "training/multires"
    assert sorted(MULTIRES) == sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")
    for place, name in enumerate(MULTIRES):
        for module, at_top in imports(folder / f"{name}.py").items():
            assert at_top, f"{name} imports {module} within a function or for type checking"
            if module.startswith("training.multires.") and ".fused" not in module:
                assert module.split(".")[-1] in MULTIRES[:place], f"{name} imports {module}"
