"""Does a pack keep its own rules? `check_pack` looks at every voxel in use, macroblock by macroblock.

Notation: as in scenepack.blocks.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from scenepack.blocks import COPIED, PADDING, along, shells, voxels_at
from scenepack.constants import EMPTY_BLOCK
from scenepack.pack import Pack

Severity = Literal["ok", "note", "warning", "error"]
CHUNK_BYTES = 64 << 20  # of atlas voxels looked at together


@dataclass(frozen=True)
class Finding:
    """One rule and how the pack keeps it. figures: the numbers behind `message`, for scripts."""

    rule: str
    severity: Severity
    message: str
    figures: Mapping[str, float] = field(default_factory=dict)


def check_pack(pack: Pack) -> list[Finding]:
    """All findings, one for each rule, kept or broken.

    "error": it cannot be rendered as meant. "warning": visible at places. "note": harmless, or waste.
    """
    findings = [_check_indices(pack)]
    if findings[0].severity == "error":  # the rest would read outside of the atlas
        return findings
    findings += [_check_shared(pack), _check_premultiplied(pack)]
    findings += [_check_padding(pack, *each) for each in zip(("rgba", "features"), pack.atlases, strict=False)]
    findings += [_check_outside(pack), _check_unused(pack)]
    return findings


def block_chunks(pack: Pack, atlas: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The occupied macroblocks, some at a time: places in the grid int [n, 3] (z, y, x) and copies [n, B, B, B, c]."""
    side = pack.padded_block_size
    where = np.argwhere(pack.occupied)
    step = max(1, CHUNK_BYTES // (side**3 * atlas.shape[3]))
    for start in range(0, len(where), step):
        blocks = where[start : start + step]
        yield blocks, atlas[voxels_at(pack.atlas_indices, blocks, [np.arange(side)] * 3, side)]


def _share(part: int, whole: int) -> str:
    return f"{part} of {whole} ({100 * part / max(whole, 1):.3g} %)"


def _check_indices(pack: Pack) -> Finding:
    used = pack.atlas_indices[pack.occupied]
    outside = int(np.any(used >= np.array(pack.atlas_blocks), axis=1).sum())
    half_empty = int(np.any(pack.atlas_indices[~pack.occupied] != EMPTY_BLOCK))
    figures = {"macroblocks": len(used), "outside": outside}
    if outside:
        return Finding("indices", "error", f"{_share(outside, len(used))} point outside of the atlas", figures)
    if not len(used):
        return Finding("indices", "warning", "every macroblock is empty: there is nothing to see", figures)
    note = ", though some empty ones are marked in x alone" if half_empty else ""
    return Finding("indices", "ok", f"{len(used)} macroblocks point into the atlas{note}", figures)


def _check_shared(pack: Pack) -> Finding:
    _, counts = np.unique(pack.atlas_indices[pack.occupied], axis=0, return_counts=True)
    shared = int(np.sum(counts > 1))
    message = f"{shared} atlas blocks are used more than once" if shared else "no atlas block is used twice"
    return Finding("shared", "warning" if shared else "ok", message, {"shared": shared})


def _check_premultiplied(pack: Pack) -> Finding:
    broken = voxels = worst = 0
    for _, copies in block_chunks(pack, pack.atlas_rgba):
        excess = copies[..., :3].max(axis=-1).astype(np.int16) - copies[..., 3]
        broken += int(np.sum(excess > 0))
        worst = max(worst, int(excess.max()))
        voxels += excess.size
    figures = {"broken": broken, "voxels": voxels, "worst": worst}
    if not broken:
        return Finding("premultiplied", "ok", "no colour is brighter than its alpha", figures)
    message = f"{_share(broken, voxels)} voxels are brighter than their alpha, by {worst}/255 at most"
    return Finding("premultiplied", "warning" if worst > 2 else "note", message, figures)


def _check_padding(pack: Pack, part: str, atlas: np.ndarray) -> Finding:
    """Compares the shells with what the neighbours hold, direction by direction."""
    copied = wrong_copy = blank = wrong_blank = worst = repeated = 0
    for blocks, copies in block_chunks(pack, atlas):
        for part_of in shells(pack.atlas_indices, pack.block_size, blocks):
            shell, inside = copies[:, *along(PADDING, part_of.step)], part_of.inside
            border = copies[:, 1:-1, 1:-1, 1:-1][:, *along(COPIED, [-s for s in part_of.step])]
            is_repeat = np.all(shell == border, axis=-1)
            stray = np.any(shell[~inside], axis=-1)
            repeated += int(np.sum(stray & is_repeat[~inside]))
            blank += stray.size
            wrong_blank += int(stray.sum())
            if not inside.any():
                continue
            difference = np.abs(shell[inside].astype(np.int16) - atlas[part_of.originals]).max(axis=-1)
            copied += difference.size
            wrong_copy += int(np.sum(difference > 0))
            repeated += int(np.sum((difference > 0) & is_repeat[inside]))
            worst = max(worst, int(difference.max(initial=0)))
    figures = {"copied": copied, "wrong_copies": wrong_copy, "worst": worst}
    figures |= {"blank": blank, "wrong_blanks": wrong_blank, "own_border_repeated": repeated}
    rule = f"padding {part}"
    if not wrong_copy and not wrong_blank:
        return Finding(rule, "ok", "every padding voxel copies its neighbour, or is zero where there is none", figures)
    parts = []
    if wrong_copy:
        parts.append(f"{_share(wrong_copy, copied)} differ from the neighbour, by {worst}/255 at most")
    if wrong_blank:
        parts.append(f"{_share(wrong_blank, blank)} hold something where the neighbour is empty")
    if repeated:
        parts.append(f"{repeated} of these repeat the macroblock's own border: seams may show")
    return Finding(rule, "warning" if wrong_copy else "note", "; ".join(parts), figures)


def _check_outside(pack: Pack) -> Finding:
    """Content in the last macroblocks that lies beyond the grid's box, where no ray samples."""
    size = pack.block_size
    voxels = 0
    for blocks, copies in block_chunks(pack, pack.atlas_rgba[..., 3:]):
        last = np.array(pack.grid_size[::-1]) - blocks * size  # data voxels within the grid, per axis
        for block_copy, (z, y, x) in zip(copies, last, strict=True):
            if min(z, y, x) < size:
                data = block_copy[1:-1, 1:-1, 1:-1, 0]
                voxels += int(np.count_nonzero(data) - np.count_nonzero(data[:z, :y, :x]))
    what = f"{voxels} voxels with alpha lie" if voxels else "nothing lies"
    return Finding("outside", "note" if voxels else "ok", f"{what} beyond the grid's box", {"voxels": voxels})


def _check_unused(pack: Pack) -> Finding:
    """Atlas blocks that no index reaches, and macroblocks without any alpha: memory for nothing."""
    x, y, z = pack.atlas_blocks
    side = pack.padded_block_size
    reached = np.zeros((z, y, x), bool)
    used = pack.atlas_indices[pack.occupied]
    reached[used[:, 2], used[:, 1], used[:, 0]] = True
    alpha, lost = pack.atlas_rgba[..., 3:], 0
    for sz, sy, sx in np.argwhere(~reached) * side:
        lost += bool(alpha[sz : sz + side, sy : sy + side, sx : sx + side].any())
    hollow = sum(int(np.sum(~copies.any(axis=(1, 2, 3, 4)))) for _, copies in block_chunks(pack, alpha))
    figures = {"unreachable": int(np.sum(~reached)), "unreachable_with_content": lost, "without_alpha": hollow}
    message = f"{figures['unreachable']} atlas blocks are spare"
    if lost:
        message += f", {lost} of them hold content that cannot be reached"
    if hollow:
        message += f"; {hollow} macroblocks in use hold no alpha at all"
    return Finding("unused", "warning" if lost else "note" if hollow else "ok", message, figures)
