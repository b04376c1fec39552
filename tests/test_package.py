"""The distribution's metadata, and the script that makes sure of what the tests need."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from importlib.metadata import metadata
from pathlib import Path

import pytest

from tests.told import told
from tests.viewer.conftest import PACKAGES
from viewer.features.making.survey import PARTS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
SCRIPT = ROOT / "scripts" / "ensure-gl.sh"


def test_a_person_who_searches_a_registry_finds_it() -> None:
    assert PROJECT["keywords"] and PROJECT["classifiers"] and PROJECT["authors"]
    least = PROJECT["requires-python"].removeprefix(">=")
    assert f"Programming Language :: Python :: {least}" in PROJECT["classifiers"]
    assert not any(entry.startswith("License ::") for entry in PROJECT["classifiers"])  # the SPDX expression says it


def test_extras_of_jax_are_called_as_jax_calls_them() -> None:
    there = metadata("jax").get_all("Provides-Extra")
    asked = {name for extra in EXTRAS.values() for entry in extra for name in re.findall(r"^jax\[(\w+)\]", entry)}
    assert asked == {"cuda12", "cuda13"} and there is not None and asked <= set(there)


def test_what_the_viewer_looks_for_is_what_the_extra_train_brings() -> None:
    brought = {re.split(r"[>=\[]", entry)[0] for entry in [*EXTRAS["train"], *PROJECT["dependencies"]]}
    assert set(PARTS) <= brought
    assert {re.split(r"[>=\[]", entry)[0] for entry in EXTRAS["train"]} <= set(PARTS)


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """A folder of programs with which the script runs, and without those that the tests of the window need."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("sh", "uname", "grep", "id", "ldconfig", "true", "touch", "chmod", "echo"):
        found = shutil.which(name, path=os.environ["PATH"] + ":/sbin:/usr/sbin")
        if found is not None:
            (folder / name).symlink_to(found)
    return folder


def ensure(folder: Path, **env: str) -> subprocess.CompletedProcess[str]:
    command = [str(folder / "sh"), str(SCRIPT)]
    return subprocess.run(command, env={"PATH": str(folder), **env}, capture_output=True, text=True, timeout=60)


@pytest.mark.skipif(os.uname().sysname != "Linux", reason="the script does nothing elsewhere")
def test_where_nothing_may_be_installed_ci_stops_and_names_all_that_is_missing(bare: Path) -> None:
    done = ensure(bare, CI="true")
    assert done.returncode == 2 and len(told(done.stderr)) == 1
    assert all(package in done.stderr for package in PACKAGES.values())
    assert not any(package in ensure(bare).stderr for package in PACKAGES.values())  # the viewer needs none of them


@pytest.mark.skipif(
    os.uname().sysname != "Linux" or os.getuid() != 0, reason="installs as root, and into a folder of ours"
)
def test_where_it_may_ci_installs_them(bare: Path) -> None:
    programs = " ".join(PACKAGES)
    apt = bare / "apt-get"
    apt.write_text(
        '#!/bin/sh\n[ "$1" = install ] || exit 0\n'
        f'echo "$@" > {bare}/asked; for p in {programs}; do echo "#!/bin/sh" > {bare}/$p; chmod +x {bare}/$p; done\n'
    )
    apt.chmod(0o755)
    assert ensure(bare, CI="true").returncode == 0
    assert all(package in (bare / "asked").read_text().split() for package in PACKAGES.values())
    (bare / "asked").unlink()
    assert ensure(bare, CI="true").returncode == 0 and not (bare / "asked").exists()  # all is there now
