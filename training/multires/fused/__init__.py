"""The multi-resolution field on processors: loops compiled by Numba, which agree with training.multires.field;
gradients agree on average.

vectors   SIMD operations for LLVM             network   the decoder's matrix products and activations
corners   vertices around samples, by level    view_mlp  the deferred head over a chunk of rays
march     samples of rays, wave by wave        chunk     a chunk of rays, forward and backward
engine    training.multires.method.Engine, and Adam
"""

from pathlib import Path

from training import scenes
from training.multires.fused.compiled import keep_compiled_code

SOURCES = Path(__file__).parent, Path(scenes.__file__).parent  # of what is compiled here
keep_compiled_code(*SOURCES)
