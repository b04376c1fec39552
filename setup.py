"""Builds wheels whose packages lie below one name: viewer/ of the repository is snerg._src.viewer there.

So no module of a user's shadows one of ours, nor the other way round. Imports are rewritten, and strings that name a module of
ours; nothing else changes. An editable install has the folders of the repository as they are.
"""

import re
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
PACKAGES = ("console", "scenepack", "training", "baker", "viewer", "shaders")
OURS = "|".join(PACKAGES)
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
    if plain := re.search(rf"^ *import (?:{OURS})\b.*", source, re.M):
        raise ValueError(f"{plain[0].strip()}: write `from package import module`")
    source = re.sub(rf"^( *from )(?=(?:{OURS})[.\w]* import\b)", rf"\1{PREFIX}", source, flags=re.M)
    return re.sub(
        rf"""(["'])((?:{OURS})(?:\.\w+)+)(?=\1)""",
        lambda name: name[1] + PREFIX * is_module(name[2]) + name[2],
        source,
    )


def is_module(name: str) -> bool:
    """Whether a dotted name is that of a module of ours."""
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildBelowOneName})
