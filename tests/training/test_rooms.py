"""The rooms within training/: which may import which, and that nothing imports in a circle or within a function."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# from bottom to top: a module of voxels/ may import those before it
VOXELS = ["config", "settings", "sparse_grid", "checked", "state", "smoothness", "coverage", "field", "engine", "lists",
          "step", "survey", "render", "saving", "jax_engine", "engines", "refine", "holes", "method"]  # fmt: skip


def imports(path: Path) -> dict[str, bool]:
    """Modules of ours that a file imports, at its top or later and for type checking, too -> whether at its top."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    return {node.module: node in tree.body for node in nodes if node.module and node.module.startswith("training")}


@pytest.mark.parametrize("path", sorted((ROOT / "training/marching").glob("*.py")), ids=lambda path: path.stem)
def test_marching_knows_no_method(path: Path) -> None:
    assert not [name for name in imports(path) if name.startswith(("training.voxels", "training.nerf"))]


def test_voxels_import_downwards_and_at_the_top_alone() -> None:
    folder = ROOT / "training/voxels"
    assert sorted(VOXELS) == sorted(path.stem for path in folder.glob("*.py") if path.stem != "__init__")
    for place, name in enumerate(VOXELS):
        for module, at_top in imports(folder / f"{name}.py").items():
            assert at_top, f"{name} imports {module} within a function or for type checking"
            if module.startswith("training.voxels."):
                assert module.split(".")[-1] in VOXELS[:place], f"{name} imports {module}"
