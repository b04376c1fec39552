"""Where compiled loops are kept from one process to the next."""

import contextlib
import hashlib
import itertools
import os
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import platformdirs
from numba import config, njit
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

KEPT = 8  # folders of compiled code that are kept


def kernel(function: Any = None, **options: Any) -> Any:
    """@njit without the GIL and without counting references, for loops that allocate nothing and return no array.

    Numba counts, by atomic operations, each array that a function gets in a tuple: 150 of them, a microsecond, for one call of a
    function with all arrays of a batch.
    """
    compiler: Any = njit
    decorate = compiler(nogil=True, cache=True, _nrt=False, **options)
    return decorate if function is None else decorate(function)


def keep_compiled_code(*folders: Path) -> None:
    """Loops of modules that are imported from now on are kept under the fingerprint of all sources in these folders.

    Numba by itself looks at each function's own file only, and would go on with code that was inlined from an older one. A
    package of loops calls this as it is imported, after the packages whose loops its own inline, and names their folders, too.
    """
    Dispatcher.enable_caching = _enable_caching  # type: ignore[method-assign]
    sources = b"".join(path.read_bytes() for folder in folders for path in sorted(folder.glob("*.py")))
    root = platformdirs.user_cache_path("snerg", appauthor=False) / "compiled"
    own = root / hashlib.sha256(sources).hexdigest()[:16]
    with contextlib.suppress(OSError):  # not writable: compiled anew in each process
        own.mkdir(parents=True, exist_ok=True)
        for old in sorted(root.iterdir(), key=lambda path: path.stat().st_mtime)[:-KEPT]:
            shutil.rmtree(old, ignore_errors=True)
        setattr(config, "CACHE_DIR", str(own))  # noqa: B010  (Numba makes its settings at import)


class _Cache(FunctionCache):
    """Numba's cache; where a file of it cannot be read or written, a loop is compiled anew."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        with contextlib.suppress(Exception):  # of the disk, or of pickle: a file that a power cut left half written
            return super().load_overload(sig, target_context)
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(Exception):  # a full disk, or an index as above
            super().save_overload(sig, data)


def _enable_caching(dispatcher: Any) -> None:
    """In place of Numba's own, which raises where neither the installation nor the user's cache can be written."""
    with contextlib.suppress(RuntimeError):
        dispatcher._cache = _Cache(dispatcher.py_func)


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Workers:
    """count: threads, this one included."""

    def __init__(self, count: int | None = None) -> None:
        self.count = max(1, count or cores())
        self._pool = ThreadPoolExecutor(self.count - 1) if self.count > 1 else None

    def share(self, parts: int, work: Callable[[int, int], None]) -> None:
        """Calls work(worker, part) for each part once, in order of parts as workers come free; returns when all are done."""
        claimed = itertools.count()  # next() is atomic

        def run(worker: int) -> None:
            while (part := next(claimed)) < parts:
                work(worker, part)

        others = [self._pool.submit(run, worker) for worker in range(1, min(self.count, parts))] if self._pool else []
        run(0)
        for other in others:
            other.result()

    def share_range(self, count: int, size: int, work: Callable[[int, int, int], None]) -> None:
        """Calls work(worker, low, high) for the numbers low … high - 1 of 0 … count - 1, `size` at a time; see share."""
        self.share(-(-count // size), lambda worker, part: work(worker, part * size, min((part + 1) * size, count)))
