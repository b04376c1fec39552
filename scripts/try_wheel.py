"""Installs DIST/snerg-*.whl in a fresh environment, and runs the README's example there beside modules named like ours."""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main(dist: str) -> int:
    (wheel,) = Path(dist).resolve().glob("snerg-*.whl")
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
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


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
