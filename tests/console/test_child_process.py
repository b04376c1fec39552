"""What we start runs our modules and Python's, whatever the user keeps in the current folder."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from console.child_process import module_command

ROOT = Path(__file__).parents[2]
PACKAGES = ("console", "scenepack", "training", "baker", "viewer")
SHADOWS = (*PACKAGES, "shaders", "random", "numpy", "json", "queue", "tempfile", "subprocess", "jax", "PIL")


@pytest.fixture
def shadowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, in which each module notes that it was imported, and fails."""
    folder = tmp_path / "of the user"
    for name in SHADOWS:
        place = folder / name / "__init__.py" if name in PACKAGES else folder / f"{name}.py"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(f"open({str(tmp_path / 'imported')!r}, 'a').write(__name__)\nraise ImportError(__name__)\n")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    return tmp_path / "imported"


@pytest.mark.parametrize("module", ["baker.commands.make", "viewer.commands.view"])
def test_commands_that_are_started_do_not_run_modules_of_the_user(shadowed: Path, module: str) -> None:
    done = subprocess.run(module_command(module, "--help"), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and "--help" in done.stdout, done.stderr
    assert not shadowed.exists()


def test_every_start_of_python_leaves_out_the_current_folder() -> None:
    started = re.compile(r"\[\s*sys\.executable,\s*([^\s,\]]+)")
    seen = 0
    for package in PACKAGES:
        for file in (ROOT / package).rglob("*.py"):
            for word in started.findall(file.read_text(encoding="utf-8")):
                seen += 1
                assert word == '"-P"', file
    assert seen >= 1 and sys.version_info >= (3, 11)
