"""The step of the voxel method for processors: loops compiled by Numba, in place of XLA's hundred array operations.

XLA's scatter runs on one core, and each intermediate of S samples × 8 corners × 8 channels goes through memory. Here a
ray's samples stay in cache from the march to the gradient. Same model, same losses, same state as training.voxels.step,
which stays the reference; tests/training/voxels/test_fused.py pins the two together.

    bricks   where the rows are          rays    training rays from their ids
    render   a chunk of rays, forward and backward, with the view MLP of head
    rows     total variation, scatter, Adam      vectors  rows of 8 floats as vectors, for LLVM
    passes   all of this over chunks of rays, up to each part
    step     one step, shared out among workers  engine   behind training.voxels.engine.Engine
"""

from __future__ import annotations

import contextlib
import hashlib
import shutil
from pathlib import Path

import platformdirs
from numba import config

KEPT = 4  # versions whose compiled code is kept


def _keep_compiled_code(folder: Path) -> None:
    """Compiled loops are kept in `folder`, under the fingerprint of all sources here.

    Numba by itself looks at each function's own file only, and would go on with code that was inlined from an older one.
    """
    sources = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    own = folder / hashlib.sha256(sources).hexdigest()[:16]
    with contextlib.suppress(OSError):  # not writable: compiled anew in each process
        own.mkdir(parents=True, exist_ok=True)
        for old in sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)[:-KEPT]:
            shutil.rmtree(old, ignore_errors=True)
        setattr(config, "CACHE_DIR", str(own))  # noqa: B010  (Numba makes its settings at import)


_keep_compiled_code(platformdirs.user_cache_path("snerg", appauthor=False) / "compiled")
