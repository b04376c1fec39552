"""A few minutes of the hour that `make events` plays."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[3]


@pytest.mark.slow
def test_random_use_of_everything_at_once_finds_nothing() -> None:
    command = [sys.executable, "-m", "tests.viewer.interface.scripted_hour", "--events", "90", "--seed", "5"]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    run = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stdout + run.stderr
    told = json.loads(run.stdout.splitlines()[-1])
    assert told["found"] == [] and sum(told["done"].values()) == 90 and len(told["done"]) >= 12
