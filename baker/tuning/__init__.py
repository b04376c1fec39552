"""What improves a pack after it is baked: pruning, and fine-tuning of the view MLP and the voxels. Compiled by Numba.

marcher      rays through a pack             cells, joint_tuning   voxels and view MLP tuned together
shading      accumulated rays as pictures    fine_tune             the view MLP alone
pruning      voxels that no photograph shows
"""

from pathlib import Path

from training.multires import fused
from training.multires.fused.compiled import keep_compiled_code

keep_compiled_code(Path(__file__).parent, *fused.SOURCES)
