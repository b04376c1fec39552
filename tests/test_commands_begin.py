"""The console scripts of pyproject.toml: each leads to its command, and Ctrl-C in its first moment is no traceback."""

import importlib
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import snerg_commands

ROOT = Path(__file__).parents[1]
SCRIPTS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
# The first module that a command imports takes its time.
SLOW = """
import builtins, sys, time
import snerg_commands
real = builtins.__import__
def slow(name, *rest):
    if name.startswith("console"):
        print("importing", flush=True)
        time.sleep(60)
    return real(name, *rest)
builtins.__import__ = slow
sys.exit(snerg_commands.pack())
"""


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_each_script_leads_to_its_command(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module, function = SCRIPTS[name].split(":")
    target = importlib.import_module(snerg_commands.MODULES[name])
    monkeypatch.setattr(target, "main", lambda: 7)
    assert module == "snerg_commands" and getattr(snerg_commands, function)() == 7


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_ctrl_c_while_modules_are_imported_is_one_line() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "importing\n"
    process.send_signal(signal.SIGINT)
    _, words = process.communicate(timeout=60)
    assert (process.returncode, words) == (snerg_commands.INTERRUPTED, "snerg-pack: interrupted\n")
