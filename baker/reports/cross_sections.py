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
from PIL import Image, ImageDraw, ImageFont

from console.atomic import replacing
from console.plots import FAINT, INK, PAPER
from scenepack import Pack
from scenepack.blocks import dense_from_pack

STORED = (221, 234, 251)  # behind voxels of macroblocks that take room
LONGEST, GAP, CAPTION = 560, 14, 24  # pixels
OPAQUE = 128  # of 255: alpha from which a voxel counts as opaque
# (rows, columns) of the picture, as axes of the grid, and whether rows run against their axis
LAYOUT = {0: (1, 2, True), 1: (2, 0, False), 2: (1, 0, True)}


@dataclass(frozen=True)
class Section:
    """rgba: uint8 [rows, columns, 4], premultiplied. stored: bool [rows, columns], in an occupied macroblock.

    low, high: world coordinates of the plane's edges, (down-axis, across-axis). step: a voxel's side. upward: rows run
    from high to low.
    """

    rgba: np.ndarray
    stored: np.ndarray
    low: np.ndarray
    high: np.ndarray
    step: float
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
    return Section(rgba, stored, pack.min_xyz[edges], pack.max_xyz[edges], pack.voxel_size, upward)


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


def placed(cut: Section, low: np.ndarray, high: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """rgba and stored of the section in the window low … high (world), a pixel a `step`: its nearest voxels, else empty."""
    picked, inside = [], []
    for axis in range(2):
        count = max(round(float(high[axis] - low[axis]) / step), 1)
        world = low[axis] + (np.arange(count) + 0.5) * (high[axis] - low[axis]) / count
        index = np.floor((world - cut.low[axis]) / cut.step).astype(int)
        sides = cut.rgba.shape[axis]
        if axis == 0 and cut.upward:
            index = sides - 1 - index[::-1]
        inside.append((index >= 0) & (index < sides))
        picked.append(np.clip(index, 0, sides - 1))
    at, seen = np.ix_(*picked), inside[0][:, None] & inside[1]  # not ix_: it would take bools for a choice
    return np.where(seen[..., None], cut.rgba[at], 0).astype(np.uint8), cut.stored[at] & seen


def draw_sections(path: Path, cuts: Mapping[str, Section]) -> None:
    """Writes a PNG: a column for each section under its label; above its opacity, below its colours. Same scale for all."""
    low = np.min([cut.low for cut in cuts.values()], axis=0)
    high = np.max([cut.high for cut in cuts.values()], axis=0)
    step = min(cut.step for cut in cuts.values())
    columns = []
    for cut in cuts.values():
        rgba, stored = placed(cut, low, high, step)
        columns.append([_fitted(opacity_picture(rgba, stored)), _fitted(colour_picture(rgba))])
    width, height = columns[0][0].size
    sheet = Image.new("RGB", (GAP + len(columns) * (width + GAP), CAPTION + 2 * (height + GAP)), PAPER)
    pen = ImageDraw.Draw(sheet)
    for i, (label, rows) in enumerate(zip(cuts, columns, strict=True)):
        left = GAP + i * (width + GAP)
        pen.text((left, CAPTION / 2), label, fill=INK, font=ImageFont.load_default(13), anchor="lm")
        for j, picture in enumerate(rows):
            top = CAPTION + j * (height + GAP)
            sheet.paste(picture, (left, top))
            pen.rectangle((left - 1, top - 1, left + width, top + height), outline=FAINT)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        sheet.save(new, format="PNG", optimize=True)


def _fitted(picture: np.ndarray) -> Image.Image:
    """About LONGEST pixels on the longer side: whole pixels a voxel where they are few, areas averaged where many."""
    height, width = picture.shape[:2]
    factor = LONGEST / max(height, width)
    image = Image.fromarray(picture)
    if factor >= 1:
        return image.resize((width * int(factor), height * int(factor)), Image.Resampling.NEAREST)
    return image.resize((max(round(width * factor), 1), max(round(height * factor), 1)), Image.Resampling.BOX)
