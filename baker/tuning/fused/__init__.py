"""Packs marched and tuned by loops that Numba compiles: on processors, in place of XLA's array operations.

marcher   baker.tuning.marcher.PackMarcher      cells   the voxels that move together, and what of them is stored
tuner     baker.tuning.tuner.Tuner
"""

from __future__ import annotations

from pathlib import Path

import training.multires.fused
from training.multires.fused.compiled import keep_compiled_code

keep_compiled_code(Path(__file__).parent, Path(training.multires.fused.__file__).parent)
