"""Start of JAX and Numba, or one line that names the environment variable that prevents it; what the C library does for them.

Both read dozens of variables, and answer an unknown value with an exception from deep within, or end the process.
"""

import contextlib
import ctypes
import importlib
import importlib.util
import os
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from console import UserError
from console.streams import one_line

XLA_FLAGS = "XLA_FLAGS"
# Reads the flags as JAX does, which takes longer and may take a GPU's memory.
READS_FLAGS = "from jaxlib import xla_client; xla_client.make_cpu_client()"
FATAL = re.compile(r"[EF]\d{4} .*?\] ")  # of XLA's log: an error, or the end
PATIENCE_S = 60.0
JAX, NUMBA = ("JAX_", "XLA_"), ("NUMBA_",)  # how the variables of each begin
PLATFORMS = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME")
OFF = ("", "0")
LONGEST_REASON = 200  # characters
MALLOPT = {-4: 0, -1: 2**31 - 1, -2: 1 << 26, -8: 1}  # glibc's M_MMAP_MAX, M_TRIM_THRESHOLD, M_TOP_PAD, M_ARENA_MAX


def begin_libraries() -> None:
    """Imports JAX and Numba and finds JAX's devices. Call before work begins. UserError where a variable prevents it."""
    import_libraries()
    find_devices()


def keep_freed_memory() -> None:
    """Makes glibc, if it is there, keep freed buffers: each step of JAX on a CPU takes them anew. Call once, early."""
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL("libc.so.6").mallopt
        for parameter, value in MALLOPT.items():
            mallopt(parameter, value)


def release_freed_memory() -> None:
    """Gives freed memory back to the system; does nothing with another C library than glibc."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def import_libraries() -> None:
    """The first half of begin_libraries, for processes that join others before JAX looks for devices."""
    _check_flags()
    with _naming_variable("JAX", JAX):
        importlib.import_module("jax")
    if (value := os.environ.get("NUMBA_DISABLE_JIT", "")) not in OFF:
        raise _problem("NUMBA_DISABLE_JIT", value, "training and baking need Numba's compiler")
    with _naming_variable("Numba", NUMBA), warnings.catch_warnings():
        warnings.filterwarnings("error", "Environment variable", RuntimeWarning)  # a value that Numba cannot parse
        importlib.import_module("numba")
    importlib.import_module("training.multires.fused")  # says where compiled loops are kept


def find_devices() -> None:
    """The second half. UserError where JAX_PLATFORMS asks for devices that are not there."""
    import jax

    with _naming_variable("JAX", JAX):
        jax.devices()


def _check_flags() -> None:
    """XLA ends the process that names a flag it does not know: another process tries."""
    value = os.environ.get(XLA_FLAGS, "")
    if not value.strip() or importlib.util.find_spec("jaxlib") is None:
        return
    command = [sys.executable, "-P", "-c", f"import sys; sys.path[:] = {sys.path!r}; {READS_FLAGS}"]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=PATIENCE_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return  # another problem, which is met again
    fatal = [line for line in done.stderr.decode(errors="replace").splitlines() if FATAL.match(line)]
    if done.returncode and fatal:
        raise _problem(XLA_FLAGS, value, fatal[0].partition("] ")[2])


@contextmanager
def _naming_variable(library: str, prefixes: Sequence[str]) -> Iterator[None]:
    """UserError for what a library raises as it starts: it names the variable that the exception names, or the only one set."""
    try:
        yield
    except ImportError:
        raise  # it is not installed
    except Exception as error:
        message = str(error) or type(error).__name__
        name = _variable_of(message, [name for name in sorted(os.environ) if name.startswith(tuple(prefixes))])
        if name is None:
            raise
        reason = message.partition(" The parse failed")[0].partition("\n")[0]
        if isinstance(error, AssertionError):
            reason = f"{library} finds no such devices"
        raise _problem(name, os.environ[name], reason) from error


def _variable_of(message: str, names: Sequence[str]) -> str | None:
    named = [name for name in names if name.lower() in message.lower()]
    valued = [name for name in names if os.environ[name] and repr(os.environ[name]).strip("'") in message]
    platforms = [name for name in PLATFORMS if name in names]
    return next(iter([*sorted(named, key=len, reverse=True), *valued, *platforms, *names]), None)


def _problem(name: str, value: str, reason: str) -> UserError:
    return UserError(
        f"{one_line(reason, LONGEST_REASON).rstrip('.')}", where=f"{name}={value}",
        remedy=f"unset this variable of the environment, or give it another value: env -u {name} COMMAND",
    )  # fmt: skip
