"""What is declared around the code: console scripts lead to their commands, workflows call make alone, and versions, packages and
extras are the same everywhere.
"""

import importlib
import re
import shutil
import signal
import subprocess
import sys
import tomllib
from importlib.metadata import metadata
from pathlib import Path
from typing import Any

import pytest

import snerg_commands
from viewer.features.making.survey import PARTS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
SCRIPTS: dict[str, str] = PROJECT["scripts"]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
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


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_runs_targets_of_make_alone_and_trusts_no_more_than_it_must(workflow: Path) -> None:
    text = workflow.read_text(encoding="utf-8")
    targets = set(re.findall(r"^([\w-]+):(?!=)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    ran = re.findall(r"^ *(?:- )?run: (\S.*)$", text, re.M)
    assert ran and all(re.fullmatch(r"make ([\w-]+)( [A-Z]+=\S+)*", line) for line in ran), ran
    assert {line.split()[1] for line in ran} <= targets
    uses = re.findall(r"uses: (\S+)", text)
    assert all(re.fullmatch(r"(actions|pypa)/[\w-]+@(v\d+|release/v1)", name) for name in uses), uses
    assert re.search(r"^permissions:\n  contents: read$", text, re.M) and "secrets." not in text and "\t" not in text


def test_every_supported_python_is_tested_on_every_system() -> None:
    text = (ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8")
    said = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    versions = re.findall(r"Python :: (3\.\d+)\"", said)
    assert text.count(f"python: [{', '.join(f'{chr(34)}{version}{chr(34)}' for version in versions)}]") == 2
    assert all(system in text for system in ("ubuntu-latest", "macos-latest", "windows-latest"))


@pytest.mark.parametrize(("tag", "status"), [("v0.1.0", 0), ("", 0), ("v9.9.9", 2)])
def test_a_tag_must_be_the_version(tag: str, status: int) -> None:
    words = [sys.executable, "scripts/release.py", "version", *filter(None, [tag])]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == status, done.stderr


def test_the_container_holds_all_that_a_wheel_is_built_from() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    copied = {word for line in re.findall(r"^COPY (?!--)(.*) \S+$", text, re.M) for word in line.split()}
    (wanted,) = re.findall(r"^PACKAGES = \((.*)\)", (ROOT / "setup.py").read_text(encoding="utf-8"), re.M)
    assert set(re.findall(r"\w+", wanted)) | {"snerg", "snerg_commands.py", "setup.py", "pyproject.toml"} <= copied
    assert all((ROOT / name).exists() for name in copied)
    shown = re.findall(r"^!(\S+)$", (ROOT / ".dockerignore").read_text(encoding="utf-8"), re.M)
    assert copied <= set(shown)
    if shutil.which("docker") and not subprocess.run(["docker", "info"], capture_output=True).returncode:
        assert not subprocess.run(["docker", "build", "--check", "."], cwd=ROOT, capture_output=True).returncode


def test_extras_of_jax_are_called_as_jax_calls_them() -> None:
    there = metadata("jax").get_all("Provides-Extra")
    asked = {name for extra in EXTRAS.values() for entry in extra for name in re.findall(r"^jax\[(\w+)\]", entry)}
    assert asked == {"cuda12", "cuda13"} and there is not None and asked <= set(there)


def test_what_the_viewer_looks_for_is_what_the_extra_train_brings() -> None:
    brought = {re.split(r"[>=\[]", entry)[0] for entry in [*EXTRAS["train"], *PROJECT["dependencies"]]}
    assert set(PARTS) <= brought
    assert {re.split(r"[>=\[]", entry)[0] for entry in EXTRAS["train"]} <= set(PARTS)


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_each_script_leads_to_its_command(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module, function = SCRIPTS[name].split(":")
    target = importlib.import_module(snerg_commands.MODULES[name])
    monkeypatch.setattr(target, "main", lambda: 7)
    assert module == "snerg_commands" and getattr(snerg_commands, function)() == 7


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_ctrl_c_while_modules_are_imported_is_one_line() -> None:
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-c", SLOW], cwd=ROOT, text=True, **pipes)
    assert process.stdout is not None and process.stdout.readline() == "importing\n"
    process.send_signal(signal.SIGINT)
    _, words = process.communicate(timeout=60)
    assert (process.returncode, words) == (snerg_commands.INTERRUPTED, "snerg-pack: interrupted\n")
