"""Says the version of pyproject.toml; exit status 2 where a tag, CITATION.cff or CHANGELOG.md has another."""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main(tag: str = "") -> int:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    cited = re.findall(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    if cited != [version] or (tag and tag != f"v{version}"):
        print(
            f"pyproject.toml has version {version}, CITATION.cff {cited}, the tag is {tag or 'not given'}",
            file=sys.stderr,
        )
        return 2
    if f"## {version}" not in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"):
        print(f"CHANGELOG.md has no section {version}", file=sys.stderr)
        return 2
    print(version)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
