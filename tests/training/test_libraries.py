"""Variables of the environment that keep JAX or Numba from starting, and places where no compiled code can be kept."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.compiling import flags_of_users

ROOT = Path(__file__).parents[2]
BEGIN = """
import sys
from console import run_command
from training.libraries import begin_libraries

def begin() -> None:
    begin_libraries()
    print("begun")

sys.exit(run_command(begin, prog="begin", args=[]))
"""
LOOPS = """
from numba import njit

@njit(cache=True)
def doubled(x):
    return 2 * x
"""
COMPILE = """
import sys
import training.multires.fused
sys.path.insert(0, sys.argv[1])
from loops import doubled
print(doubled(21), len(doubled.stats.cache_hits))
"""


def python(code: str, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "NUMBA_"))}
    environment = kept | {"XLA_FLAGS": flags_of_users()} | environment
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("JAX_PLATFORMS", "rocm"),
        ("JAX_PLATFORM_NAME", "foo"),
        ("JAX_ENABLE_X64", "perhaps"),
        ("NUMBA_DISABLE_JIT", "1"),
        ("NUMBA_NUM_THREADS", "0"),
        ("NUMBA_NUM_THREADS", "many"),
    ],
)
def test_a_variable_that_does_not_fit_is_named_with_its_value_in_one_line(name: str, value: str) -> None:
    done = python(BEGIN, **{name: value})
    assert done.returncode == 2 and done.stdout == "", done.stderr
    assert done.stderr.startswith(f"begin: {name}={value}: ") and done.stderr.count("\n") == 1
    assert "unset these variables" in done.stderr


@pytest.mark.slow
def test_variables_that_fit_are_no_obstacle() -> None:
    flags = f"{flags_of_users()} --xla_force_host_platform_device_count=2".strip()
    done = python(BEGIN, JAX_PLATFORMS="cpu", JAX_ENABLE_X64="1", NUMBA_NUM_THREADS="1", NUMBA_DISABLE_JIT="0",
                  OMP_NUM_THREADS="many", XLA_FLAGS=flags)  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "begun\n", "")


@pytest.mark.slow
def test_loops_are_compiled_anew_where_nothing_can_be_kept(tmp_path: Path) -> None:
    (tmp_path / "loops.py").write_text(LOOPS)
    (tmp_path / "__pycache__").write_text("no folder can be made here, nor in /proc")
    for _ in range(2):
        nowhere = {"HOME": "/proc/none", "XDG_CACHE_HOME": "/proc/none", "PYTHONDONTWRITEBYTECODE": "1"}
        done = python(COMPILE, str(tmp_path), **nowhere)
        assert (done.stdout, done.stderr) == ("42 0\n", "")
