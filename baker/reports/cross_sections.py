"""Cross-sections of baked grids, as pictures (the SNeRG paper's figure on the sparsity loss).

A section is a plane of voxels across one axis of the OpenGL grid frame (y up), turned as one would look at it: rows from
top to bottom, columns from left to right; across x it shows (y up, z to the right), across y a plan (z down, x to the
right), across z an elevation (y up, x to the right).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from console.atomic import replacing
from console.plots import INK, PAPER, require_plots
from scenepack import Pack
from scenepack.blocks import dense_from_pack

STORED = (221, 234, 251)  # behind voxels of macroblocks that take room
SIDE, CAPTION, DPI = 5.6, 0.4, 100  # inches of a section's longer side, and above it
OPAQUE = 128  # of 255: alpha from which a voxel counts as opaque
# (rows, columns) of the picture, as axes of the grid, and whether rows run against their axis
LAYOUT = {0: (1, 2, True), 1: (2, 0, False), 2: (1, 0, True)}


@dataclass(frozen=True)
class Section:
    """rgba: uint8 [rows, columns, 4], premultiplied. stored: bool [rows, columns], in an occupied macroblock.

    low, high: world coordinates of the plane's edges, (down-axis, across-axis). upward: rows run from high to low.
    """

    rgba: np.ndarray
    stored: np.ndarray
    low: np.ndarray
    high: np.ndarray
    upward: bool


def section(pack: Pack, axis: int, at: float) -> Section:
    """The voxels that the plane at world coordinate `at` of an axis cuts; empty where it passes by the grid."""
    down, across, upward = LAYOUT[axis]
    index = int(np.floor((at - pack.min_xyz[axis]) / pack.voxel_size))
    low, high = [0, 0, 0], list(pack.grid_size)
    shape = pack.grid_size[down], pack.grid_size[across]
    rgba, stored = np.zeros((*shape, 4), np.uint8), np.zeros(shape, bool)
    if 0 <= index < pack.grid_size[axis]:
        low[axis], high[axis] = index, index + 1
        dense = dense_from_pack(pack, ((low[0], low[1], low[2]), (high[0], high[1], high[2])))[0]
        rgba = dense.transpose(2 - down, 2 - across, 2 - axis, 3)[:, :, 0]
        blocks = pack.occupied.transpose(2 - down, 2 - across, 2 - axis)[:, :, index // pack.block_size]
        stored = np.kron(blocks, np.ones((pack.block_size, pack.block_size), bool))[: shape[0], : shape[1]]
    if upward:
        rgba, stored = rgba[::-1], stored[::-1]
    edges = [down, across]
    return Section(rgba, stored, pack.min_xyz[edges], pack.max_xyz[edges], upward)


def shares(cut: Section) -> dict[str, float]:
    """Of the plane's voxels: how many are opaque (alpha of 128 or more), have any alpha, lie in stored macroblocks."""
    alpha = cut.rgba[..., 3]
    return {
        "opaque": float((alpha >= OPAQUE).mean()),
        "with_alpha": float((alpha > 0).mean()),
        "stored": float(cut.stored.mean()),
    }


def opacity_picture(rgba: np.ndarray, stored: np.ndarray) -> np.ndarray:
    """uint8 [rows, columns, 3]: ink by the square root of alpha, so that faint fog is seen; stored macroblocks are blue."""
    ink = np.sqrt(rgba[..., 3:] / 255.0)
    paper = np.where(stored[..., None], np.array(STORED, float), np.array(PAPER, float))
    return np.round(paper * (1 - ink) + np.array(INK, float) * ink).astype(np.uint8)


def colour_picture(rgba: np.ndarray) -> np.ndarray:
    """uint8 [rows, columns, 3]: the diffuse colours over white."""
    return np.minimum(rgba[..., :3].astype(int) + 255 - rgba[..., 3:], 255).astype(np.uint8)


def draw_sections(path: Path, cuts: Mapping[str, Section]) -> None:
    """Writes a PNG: a column for each section under its label; above its opacity, below its colours. Same scale for all."""
    require_plots()
    from matplotlib.figure import Figure

    low = np.min([cut.low for cut in cuts.values()], axis=0)
    high = np.max([cut.high for cut in cuts.values()], axis=0)
    down, across = SIDE * (high - low) / (high - low).max()
    figure = Figure((across * len(cuts), 2 * down + CAPTION), layout="constrained")
    rows = figure.subplots(2, len(cuts), sharex=True, sharey=True, squeeze=False)
    for (label, cut), opacity, colours in zip(cuts.items(), *rows, strict=True):
        opacity.set_title(label, loc="left", fontsize=9, parse_math=False)
        edges = (cut.low[0], cut.high[0]) if cut.upward else (cut.high[0], cut.low[0])
        for axes, picture in ((opacity, opacity_picture(cut.rgba, cut.stored)), (colours, colour_picture(cut.rgba))):
            axes.imshow(picture, extent=(cut.low[1], cut.high[1], *edges))
            axes.set(xlim=(low[1], high[1]), ylim=(low[0], high[0])[:: 1 if cut.upward else -1], xticks=[], yticks=[])
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        figure.savefig(new, format="png", dpi=DPI, metadata={"Software": None})
