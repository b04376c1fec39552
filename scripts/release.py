"""Checks of a release: its version is the same everywhere, and its wheel works.

python scripts/release.py version [TAG]     says the version of pyproject.toml; exit status 2 where TAG, CITATION.cff or
                                            CHANGELOG.md has another
python scripts/release.py try-wheel DIST    installs DIST/snerg-*.whl in a fresh environment, and runs the README's example
                                            there beside modules named like ours
"""

import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def check_version(tag: str = "") -> int:
    version = tomllib.loads(text_of("pyproject.toml"))["project"]["version"]
    cited = re.findall(r"^version: (\S+)$", text_of("CITATION.cff"), re.M)
    if cited != [version] or (tag and tag != f"v{version}"):
        print(
            f"pyproject.toml has version {version}, CITATION.cff {cited}, the tag is {tag or 'not given'}",
            file=sys.stderr,
        )
        return 2
    if f"## {version}" not in text_of("CHANGELOG.md"):
        print(f"CHANGELOG.md has no section {version}", file=sys.stderr)
        return 2
    print(version)
    return 0


def try_wheel(dist: str) -> int:
    (wheel,) = Path(dist).resolve().glob("snerg-*.whl")
    (example,) = re.findall(r"```python\n(.*?)```", text_of("README.md"), re.S)
    with tempfile.TemporaryDirectory() as name:
        folder, work = Path(name) / "fresh", Path(name) / "work"
        work.mkdir()
        subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
        python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", str(wheel)], check=True)
        for module in ("training", "viewer"):
            (work / f"{module}.py").write_text("raise ImportError('a module of the user')\n", encoding="utf-8")
        (work / "example.py").write_text(example, encoding="utf-8")
        subprocess.run([str(python), "-m", "snerg", "pack", "--help"], cwd=work, check=True, stdout=subprocess.DEVNULL)
        if sys.platform == "win32":  # hosted Windows has OpenGL 1.1 alone
            example = "import snerg; print(snerg.load(snerg.demo()))"
            (work / "example.py").write_text(example, encoding="utf-8")
        subprocess.run([str(python), "example.py"], cwd=work, check=True)
        if sys.platform != "win32":
            (Path(dist) / "example.png").write_bytes((work / "island.png").read_bytes())
    print(f"{wheel.name} works")
    return 0


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


if __name__ == "__main__":
    sys.exit({"version": check_version, "try-wheel": try_wheel}[sys.argv[1]](*sys.argv[2:]))
