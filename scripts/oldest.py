"""Prints constraints for pip: of all that snerg needs, the oldest release series that pyproject.toml allows.

    python scripts/oldest.py > constraints.txt

"numpy>=2.0" becomes "numpy==2.0.*"; where three numbers are given, that very release. Developers' tools are left out.
"""

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
EXTRAS = ("train", "video", "poses", "export")
BOUND = re.compile(r"(?P<name>[A-Za-z0-9_.-]+)(\[[^]]*\])?>=(?P<version>[0-9.]+)$")


def oldest(requirement: str) -> str:
    """ "numpy>=2.0" as "numpy==2.0.*". ValueError where there is no lower bound, or something beside it."""
    match = BOUND.match(requirement)
    if match is None:
        raise ValueError(f"{requirement!r} in {PROJECT.name} is no lower bound of the kind name>=1.2")
    version = match["version"]
    return f"{match['name']}=={version if version.count('.') >= 2 else version + '.*'}"


def main() -> None:
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    extras = [requirement for extra in EXTRAS for requirement in project["optional-dependencies"][extra]]
    print(*map(oldest, [*project["dependencies"], *extras]), sep="\n")


if __name__ == "__main__":
    main()
