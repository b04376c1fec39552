"""Random synthetic packs, small enough for a reference marcher: `random_pack` and the strategy `packs`.

Their grids hold what a marcher gets wrong first: alphas from 1/255 up, isolated voxels, shells one voxel
thick, content that touches macroblock borders and the edges of the grid, grids that are no multiple of the
block size.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter

from scenepack.blocks import choose_atlas_blocks, grid_block_counts
from scenepack.constants import VIEW_MLP_WIDTHS
from scenepack.pack import Pack, ViewMlp
from tests.scenepack.volumes import BLENDER_FRAME, NDC_FRAME, atlas_from_dense, occupied_blocks

CONTENT_STYLES = ("noise", "isolated", "shell", "borders", "blob", "mixed")
ALPHA_STYLES = ("any", "faint", "solid")


def random_view_mlp(rng: np.random.Generator, scale: float = 1.0) -> ViewMlp:
    """A view MLP whose output visibly changes with direction, colour and features."""
    pairs = list(pairwise(VIEW_MLP_WIDTHS))
    weights = [rng.normal(0, scale * np.sqrt(2 / a), (a, b)).astype(np.float32) for a, b in pairs]
    biases = [rng.normal(0, 0.3 * scale, b).astype(np.float32) for _, b in pairs]
    return ViewMlp((weights[0], weights[1], weights[2]), (biases[0], biases[1], biases[2]))


def random_content(
    rng: np.random.Generator, size: tuple[int, int, int], block_size: int, occupancy: float, style: str
) -> np.ndarray:
    """bool [z, y, x]: where a grid of `size` (x, y, z) voxels holds something."""
    shape = size[::-1]
    z, y, x = np.indices(shape, sparse=True)
    if style == "noise":
        return rng.random(shape) < occupancy
    if style == "isolated":
        content = np.zeros(shape, bool)
        count = int(rng.integers(1, 13))
        content[tuple(rng.integers(0, n, count) for n in shape)] = True
        return content
    if style == "borders":  # the first and last layer of every macroblock, hence also the grid's own faces
        edge = [(i % block_size == 0) | (i % block_size == block_size - 1) for i in (z, y, x)]
        return (edge[0] | edge[1] | edge[2]) & (rng.random(shape) < occupancy)
    centre = [rng.uniform(0.2, 0.8) * n for n in shape]
    squash = rng.uniform(0.6, 1.6, 3)
    squares = [((i + 0.5 - c) * s) ** 2 for i, c, s in zip((z, y, x), centre, squash, strict=True)]
    radius = np.sqrt(squares[0] + squares[1] + squares[2])
    wanted = rng.uniform(0.25, 0.6) * min(shape)
    if style == "shell":
        return np.abs(radius - wanted) < 0.5
    if style == "blob":
        return radius < wanted
    parts = [random_content(rng, size, block_size, occupancy * 0.2, s) for s in ("isolated", "shell", "borders")]
    return parts[0] | parts[1] | parts[2]


def random_alpha(rng: np.random.Generator, content: np.ndarray, style: str) -> np.ndarray:
    """uint8 [z, y, x]: alpha of at least 1 where there is content."""
    if style == "faint":
        alpha = rng.integers(1, 5, content.shape)
    elif style == "solid":
        alpha = rng.integers(200, 256, content.shape)
    else:  # spread evenly in the logarithm, so that 1/255 and 255/255 both turn up
        alpha = np.exp(rng.uniform(0, np.log(256), content.shape)).astype(int)
    return np.where(content, np.clip(alpha, 1, 255), 0).astype(np.uint8)


def random_pack(
    rng: np.random.Generator,
    *,
    block_size: int = 14,
    grid_blocks: tuple[int, int, int] = (3, 2, 2),
    occupancy: float = 0.05,
    style: str | None = None,
    alpha_style: str = "any",
    diffuse: bool = False,
    ndc: bool = False,
    whole_blocks: bool = False,
) -> Pack:
    """A valid pack with correct padding copies and premultiplied content.

    grid_blocks: macroblocks (x, y, z). occupancy: share of voxels with content, for the styles that have
    one. style: one of CONTENT_STYLES, None draws one. alpha_style: one of ALPHA_STYLES. diffuse: no features
    and no view MLP. ndc: forward-facing, over the NDC cube. whole_blocks: keep the grid a multiple of the
    block size.
    """
    x, y, z = (n * block_size - (0 if whole_blocks else int(rng.integers(block_size))) for n in grid_blocks)
    size = (x, y, z)
    content = random_content(rng, size, block_size, occupancy, style or str(rng.choice(CONTENT_STYLES)))
    alpha = random_alpha(rng, content, alpha_style)
    colours = rng.random((*alpha.shape, 3 + 4))
    # Voxels share much of their colour, as in a real scene; otherwise everything averages to grey.
    tint = rng.random((3, 3 + 4))
    colours = 0.5 * colours + 0.5 * tint[rng.integers(3)]
    premultiplied = np.minimum(np.rint(colours * alpha[..., None]), alpha[..., None]).astype(np.uint8)
    rgba = np.concatenate([premultiplied[..., :3], alpha[..., None]], axis=-1)
    # half of the packs also store macroblocks beside content, all of whose voxels are empty
    occupied = occupied_blocks(maximum_filter(alpha, 3) if rng.integers(2) else alpha, block_size)
    ax, ay, az = choose_atlas_blocks(int(occupied.sum()), block_size)
    layout = (ax + 1, ay, az) if rng.integers(2) else (ax, -(-ay // 2), 2 * az)
    indices, atlas_rgba, atlas_features = atlas_from_dense(
        rgba, None if diffuse else premultiplied[..., 3:], block_size, occupied, atlas_blocks=layout
    )
    assert occupied.shape[::-1] == grid_block_counts(size, block_size)
    voxel_size = 2.0 / max(size)
    frame = {"ndc": True, "input_width": 64.0, "input_height": 48.0, "input_focal": 60.0} if ndc else {}
    return Pack(
        voxel_size=voxel_size,
        min_xyz=-0.5 * voxel_size * np.asarray(size, float),
        grid_size=size,
        block_size=block_size,
        atlas_indices=indices,
        atlas_rgba=atlas_rgba,
        atlas_features=atlas_features,
        view_mlp=None if diffuse else random_view_mlp(rng),
        worldspace_T_opengl=NDC_FRAME.copy() if ndc else BLENDER_FRAME.copy(),
        **frame,
    )


def packs(*, block_sizes: tuple[int, ...] = (14, 30), ndc: bool | None = False) -> st.SearchStrategy[Pack]:
    """Hypothesis strategy over random_pack. ndc: None draws it."""

    def build(seed: int, block_size: int, blocks: tuple[int, int, int], **options: Any) -> Pack:
        # A macroblock of 30 has ten times the voxels of one of 14; keep examples cheap.
        limit = 3 if block_size < 20 else 2
        x, y, z = (min(n, limit) for n in blocks)
        return random_pack(np.random.default_rng(seed), block_size=block_size, grid_blocks=(x, y, z), **options)

    counts = st.integers(1, 3)
    return st.builds(
        build,
        st.integers(0, 2**32 - 1),
        st.sampled_from(block_sizes),
        st.tuples(counts, counts, counts),
        style=st.sampled_from(CONTENT_STYLES),
        occupancy=st.sampled_from((0.002, 0.02, 0.2)),
        alpha_style=st.sampled_from(ALPHA_STYLES),
        diffuse=st.booleans(),
        ndc=st.booleans() if ndc is None else st.just(ndc),
    )
