"""Builds wheels whose packages lie below one name: viewer/ of the repository is snerg._src.viewer there.

So no module of a user's shadows one of ours, nor the other way round. Imports are rewritten, and strings that name a module of
ours; nothing else changes. An editable install has the folders of the repository as they are.
"""

import ast
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
PACKAGES = ("console", "scenepack", "training", "baker", "viewer", "shaders")
PREFIX = "snerg._src."


class BuildBelowOneName(build_py):
    """Moves the packages into snerg/_src once they are copied."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        library = Path(self.build_lib)
        below = library.joinpath(*PREFIX.split(".")[:-1])
        shutil.rmtree(below, ignore_errors=True)
        below.mkdir()
        (below / "__init__.py").write_text('"""Private: changes without notice."""\n', encoding="utf-8")
        for name in PACKAGES:
            shutil.move(library / name, below / name)
        for file in [*library.glob("*.py"), *library.joinpath("snerg").rglob("*.py")]:
            file.write_text(rewritten(file.read_text(encoding="utf-8")), encoding="utf-8")


def rewritten(source: str) -> str:
    """A module that finds our packages below PREFIX. ValueError for imports whose names would change."""
    lines = [line.encode() for line in source.splitlines(keepends=True)]
    places: list[tuple[int, int]] = []  # line and column (bytes) of names that get the prefix
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            if any(alias.name.split(".")[0] in PACKAGES for alias in node.names):
                raise ValueError(f"line {node.lineno}: write `from package import module`")
        elif isinstance(node, ast.ImportFrom):
            if node.level == 0 and (node.module or "").split(".")[0] in PACKAGES:
                places.append((node.lineno - 1, node.col_offset + len("from ")))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and names_module(node.value):
            at = lines[node.lineno - 1][node.col_offset : node.end_col_offset]
            if at[1:-1] == node.value.encode():
                places.append((node.lineno - 1, node.col_offset + 1))
    for line, column in sorted(places, reverse=True):
        lines[line] = lines[line][:column] + PREFIX.encode() + lines[line][column:]
    return b"".join(lines).decode()


def names_module(text: str) -> bool:
    """Whether a text is the dotted name of a module within our packages."""
    parts = text.split(".")
    if len(parts) < 2 or parts[0] not in PACKAGES or not all(part.isidentifier() for part in parts):
        return False
    path = ROOT.joinpath(*parts)
    return path.is_dir() or path.with_suffix(".py").is_file()


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildBelowOneName})
