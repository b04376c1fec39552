"""Where compiled loops are kept from one process to the next."""

from __future__ import annotations

import contextlib
import hashlib
import shutil
from pathlib import Path

import platformdirs
from numba import config

KEPT = 8  # folders of compiled code that are kept


def keep_compiled_code(*folders: Path) -> None:
    """Loops of modules that are imported from now on are kept under the fingerprint of all sources in these folders.

    Numba by itself looks at each function's own file only, and would go on with code that was inlined from an older one. A
    package of loops calls this as it is imported, after the packages whose loops its own inline, and names their folders, too.
    """
    sources = b"".join(path.read_bytes() for folder in folders for path in sorted(folder.glob("*.py")))
    root = platformdirs.user_cache_path("snerg", appauthor=False) / "compiled"
    own = root / hashlib.sha256(sources).hexdigest()[:16]
    with contextlib.suppress(OSError):  # not writable: compiled anew in each process
        own.mkdir(parents=True, exist_ok=True)
        for old in sorted(root.iterdir(), key=lambda path: path.stat().st_mtime)[:-KEPT]:
            shutil.rmtree(old, ignore_errors=True)
        setattr(config, "CACHE_DIR", str(own))  # noqa: B010  (Numba makes its settings at import)
