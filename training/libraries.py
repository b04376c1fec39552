"""Start of JAX and Numba, or one line that names the environment variables that prevent it; what the C library does for them.

Both read dozens of variables, and answer an unknown value with an exception from deep within.
"""

import contextlib
import ctypes
import importlib
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from console import UserError
from console.streams import one_line

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
    with _blaming("JAX_"):
        importlib.import_module("jax")
    with _blaming("NUMBA_"), warnings.catch_warnings():
        warnings.filterwarnings("error", "Environment variable", RuntimeWarning)  # a value that Numba cannot parse
        if importlib.import_module("numba").config.DISABLE_JIT:
            raise RuntimeError("training and baking need Numba's compiler")
    importlib.import_module("training.multires.fused")  # says where compiled loops are kept


def find_devices() -> None:
    """The second half. UserError where JAX_PLATFORMS asks for devices that are not there."""
    import jax

    with _blaming("JAX_"):
        jax.devices()


@contextmanager
def _blaming(prefix: str) -> Iterator[None]:
    """UserError, with the variables of the environment that begin so, for what a library raises as it starts where any is set."""
    try:
        yield
    except ImportError:
        raise  # it is not installed
    except Exception as error:
        names = sorted(name for name in os.environ if name.startswith(prefix))
        if not names:
            raise
        reason = one_line(str(error) or f"{type(error).__name__} from within", LONGEST_REASON)
        raise UserError(reason, where=" ".join(f"{name}={os.environ[name]}" for name in names),
                        remedy="unset these variables of the environment, or give them other values") from error  # fmt: skip
