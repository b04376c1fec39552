"""How the programs of tests are compiled: once, and quickly; where numbers must repeat to the last bit, as users have them."""

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pytest

FOLDER = "JAX_COMPILATION_CACHE_DIR"
FLAGS = "XLA_FLAGS"
CONSTRAINTS = Path(__file__).parents[1] / "constraints.txt"
# Of each: what makes compiling quick, and what XLA takes by itself. Level 0 is no quicker: what it makes runs too slowly.
QUICK = {
    "xla_backend_optimization_level": ("1", "3"),
    "xla_llvm_disable_expensive_passes": ("True", "False"),
    "xla_cpu_use_fusion_emitters": ("False", "True"),
    "xla_cpu_prefer_vector_width": ("128", "256"),
}


def compile_once_and_quickly(add_cleanup: Callable[[Callable[[], None]], None]) -> None:
    """What one test compiles, no other compiles again: not in another worker, nor in a program that a test starts."""
    if FOLDER not in os.environ:
        folder = tempfile.mkdtemp(prefix="snerg-compiled-")
        os.environ[FOLDER] = folder
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))
    if flags_of_users().split() == os.environ.get(FLAGS, "").split() and _is_the_pinned_compiler():
        quick = [f"--{name}={value}" for name, (value, _) in QUICK.items()]
        os.environ[FLAGS] = " ".join([*quick, os.environ.get(FLAGS, "")]).strip()


def _is_the_pinned_compiler() -> bool:
    """Another one may not know the flags, and ends the process that names a flag it does not know."""
    pinned = re.search(r"^jaxlib?==(\S+)", CONSTRAINTS.read_text(), re.MULTILINE)
    try:
        return pinned is not None and version("jaxlib") == pinned[1]
    except PackageNotFoundError:
        return False


def flags_of_users() -> str:
    """XLA_FLAGS without ours: for programs that a test starts."""
    words = os.environ.get(FLAGS, "").split()
    return " ".join(word for word in words if word.lstrip("-").split("=")[0] not in QUICK)


@contextmanager
def as_users_have_it() -> Iterator[None]:
    """What is compiled until the `with` block ends, here and in programs that are started, is compiled as it is for users."""
    import jax
    from jax._src import compiler  # JAX has no public option that reaches each compilation

    of_tests = compiler.get_compile_options

    def of_users(*words: Any, **named: Any) -> Any:
        options = of_tests(*words, **named)
        ours = [(name, usual) for name, (_, usual) in QUICK.items()]
        options.env_option_overrides = [*ours, *options.env_option_overrides]
        return options

    jax.clear_caches()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "get_compile_options", of_users)
        patch.setenv(FLAGS, flags_of_users())
        yield
    jax.clear_caches()
