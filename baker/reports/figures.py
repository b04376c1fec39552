"""Pictures of a report: the paper's figures of quality, and plots of the tables.

A figure is the same crop of several pictures and the photograph, side by side, PSNR below each: of the view that differs most
between the first and the last picture, the square whose differences are largest. Scoring left the pictures.

A cross-section is a plane of voxels across one axis of the OpenGL grid frame (y up), as in the figure on the sparsity loss. Rows
go from top to bottom, columns from left to right: across x (y up, z to the right), across y a plan (z down, x to the right),
across z an elevation (y up, x to the right).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont

from baker.reports.report_cache import Study
from console.atomic import replacing
from console.plots import INK, PAPER, Line, Plot, draw_plots, require_plots
from scenepack import Pack
from scenepack.blocks import dense_from_pack
from training.scenes import picture_stems

SHARE = 0.3  # of the picture's shorter side: the crop's
PANEL, GAP, CAPTION, LETTERS = 240, 10, 40, 34  # pixels of a panel's side, between panels, below one; letters in a line
FIGURES: Mapping[str, Sequence[str]] = {  # rows, from left to right; those that were not measured are left out
    "ablation": ("jaxnerf-plus", "tinyview", "deferred", "field", "snerg", "ours-full", "diffuse"),
    "fine-tuning": ("float", "8-bit", "snerg", "ours-full"),
}
SHORT = {
    "float": "SNeRG (float)", "8-bit": "no fine-tuning", "snerg": "SNeRG (PNG)", "ours-full": "ours", "diffuse": "Diffuse",
    "jaxnerf-plus": "JAXNeRF+", "tinyview": "Tinyview", "deferred": "Deferred",
}  # fmt: skip


def draw_figure(
    study: Study, rows: Sequence[Mapping[str, Any]], names: Sequence[str], path: Path
) -> dict[str, Any] | None:
    """Writes the panels of rows `names` that have pictures, and the photograph; None where fewer than two have.

    Returns {"picture", "view"}.
    """
    by_name = {row["row"]: row for row in rows}
    shown = [by_name[name] for name in names if "pictures" in by_name.get(name, {})]
    if len(shown) < 2:
        return None
    views = list(shown[0]["views"])
    view = max(range(len(views)), key=lambda i: abs(shown[0]["views"][views[i]] - shown[-1]["views"][views[i]]))
    pairs = [_pictures(study.out / row["pictures"] / f"{picture_stems(study.photographs)[view]}.png") for row in shown]
    box = _most_different(pairs[0][0], pairs[-1][0], pairs[0][1])
    captions = [f"{SHORT.get(row['row']) or row['label']} ({row['views'][views[view]]:.2f} dB)" for row in shown]
    panels = [(picture, caption) for (picture, _), caption in zip(pairs, captions, strict=True)]
    draw_panels([*panels, (pairs[0][1], "photograph")], box, path)
    return {"picture": path.name, "view": views[view]}


def _pictures(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The picture and the photograph of a comparison that baker.reports.evaluation wrote; see save_comparison."""
    with Image.open(path, formats=["PNG"]) as opened:
        picture, photograph, _ = np.split(np.asarray(opened.convert("RGB")), 3, axis=1)
    return picture, photograph


def _most_different(first: np.ndarray, last: np.ndarray, photograph: np.ndarray) -> tuple[int, int, int]:
    """left, top and side in pixels of the square where the pictures differ most from each other and from the photograph."""
    pictures = [picture.astype(np.float32) for picture in (first, last, photograph)]
    error = sum(np.abs(a - pictures[2]).mean(-1) for a in pictures[:2]) + np.abs(pictures[0] - pictures[1]).mean(-1)
    height, width = error.shape
    side = max(round(SHARE * min(height, width)), 1)
    sums = np.pad(np.cumsum(np.cumsum(error, 0), 1), ((1, 0), (1, 0)))
    square = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
    top, left = np.unravel_index(int(np.argmax(square)), square.shape)
    return int(left), int(top), side


def draw_panels(panels: Sequence[tuple[np.ndarray, str]], box: tuple[int, int, int], path: Path) -> None:
    """A row of pictures (uint8 [H, W, 3]) with captions: the crop, whole pixels enlarged; above, all with the crop's frame."""
    left, top, side = box
    height, width = panels[0][0].shape[:2]
    small = PANEL, round(PANEL * height / width)
    resampling = Image.Resampling.BOX if width > PANEL else Image.Resampling.NEAREST
    sheet = Image.new("RGB", (GAP + len(panels) * (PANEL + GAP), small[1] + PANEL + 3 * GAP + CAPTION), PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    for i, (pixels, caption) in enumerate(panels):
        x, picture = GAP + i * (PANEL + GAP), Image.fromarray(np.ascontiguousarray(pixels))
        sheet.paste(picture.resize(small, resampling), (x, GAP))
        scale = PANEL / width
        frame = [x + left * scale, GAP + top * scale, x + (left + side) * scale, GAP + (top + side) * scale]
        pen.rectangle([round(edge) for edge in frame], outline=(207, 74, 34))
        crop = picture.crop((left, top, left + side, top + side))
        sheet.paste(crop.resize((PANEL, PANEL), Image.Resampling.NEAREST), (x, small[1] + 2 * GAP))
        for line, text in enumerate(wrap(caption, LETTERS)[:2]):
            pen.text((x, small[1] + PANEL + 2 * GAP + 4 + 15 * line), text, fill=INK, font=font)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        sheet.save(new, format="PNG", optimize=True)


# --- plots: resolution.png, storage.png and sparsity.png ---

ALPHA_BINS = 16


def draw_report_plots(out: Path, tables: Mapping[str, Mapping[str, Any]]) -> None:
    """Draws what there is; the paper's own figures of resolutions as a line of theirs."""
    if "resolution" in tables:
        _draw_resolution(out / "resolution.png", tables["resolution"]["rows"])
    if "storage" in tables:
        measured = [{**row, "mb": row["bytes"] / 1e6} for row in tables["storage"]["rows"] if row.get("codec")]
        names = dict.fromkeys(row["codec"] for row in measured)
        lines = [_over([r for r in measured if r["codec"] == n], "mb", n, lambda r: r["psnr"]) for n in names]
        draw_plots(out / "storage.png", [Plot(lines, "Quality and size, by codec", "MB on disk", "PSNR (dB)", "data")])
    if "sparsity" in tables:
        lines = []
        for row in tables["sparsity"]["rows"]:
            if "alpha_histogram" in row:
                counts = np.concatenate([[0], np.asarray(row["alpha_histogram"])]).reshape(ALPHA_BINS, -1).sum(1)
                share = (100 * counts / max(row["voxels"]["stored"], 1)).tolist()
                middles = [(i + 0.5) / ALPHA_BINS for i in range(ALPHA_BINS)]
                lines.append(Line(row["label"], middles, share, marked=True))
        draw_plots(out / "sparsity.png", [
            Plot(lines, "Opacity of stored voxels (alpha 0 left out)", "alpha", "% of stored voxels", "zero")
        ])  # fmt: skip


def _draw_resolution(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    measured = {label: [r for r in rows if r["sparsity"] == on and "psnr" in r]
                for label, on in (("with the sparsity loss", True), ("without", False))}  # fmt: skip
    printed = [{"resolution": r["resolution"], **r["paper"]} for r in rows if r["paper"]]
    x_label = "voxels along the longest side"

    def lines(ours: Callable[[Any], float], theirs: Callable[[Any], float] | None) -> list[Line]:
        drawn = [_over(some, "resolution", label, ours) for label, some in measured.items() if some]
        return drawn + ([_over(printed, "resolution", "the paper", theirs)] if theirs and printed else [])

    plots = [
        Plot(lines(lambda r: r["psnr"], lambda r: r["psnr"]), "Quality and resolution", x_label, "PSNR (dB)", "data"),
        Plot(lines(lambda r: r["bytes"] / 1e6, lambda r: r["mb"]), "Size and resolution", x_label, "MB on disk"),
        Plot(lines(lambda r: r["ms_p50"], None), "Frame time and resolution (exact, p50)", x_label, "milliseconds"),
    ]
    draw_plots(path, plots, (720, 270))


def _over(rows: Iterable[Mapping[str, Any]], key: str, label: str, value: Callable[[Any], float]) -> Line:
    points = sorted((float(row[key]), float(value(row))) for row in rows)
    return Line(label, [x for x, _ in points], [y for _, y in points], marked=True)


# --- Cross-sections ---------------------------------------------------------------------------------------------------

STORED = "#ddeafb"  # behind voxels of macroblocks that take room
SIDE, TITLE, DPI = 5.6, 0.4, 100  # inches of a section's longer side, and above it
OPAQUE = 128  # of 255: alpha from which a voxel counts as opaque
# (rows, columns) of the picture, as axes of the grid, and whether rows run against their axis
LAYOUT = {0: (1, 2, True), 1: (2, 0, False), 2: (1, 0, True)}


@dataclass(frozen=True)
class Section:
    """A plane of voxels."""

    rgba: np.ndarray  # uint8 [rows, columns, 4], premultiplied
    stored: np.ndarray  # bool [rows, columns]: in an occupied macroblock
    low: np.ndarray  # world coordinates of the plane's edges, (down-axis, across-axis)
    high: np.ndarray
    upward: bool  # rows run from high to low


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
    held = {"opaque": cut.rgba[..., 3] >= OPAQUE, "with_alpha": cut.rgba[..., 3] > 0, "stored": cut.stored}
    return {name: float(where.mean()) for name, where in held.items()}


def opacity_picture(rgba: np.ndarray, stored: np.ndarray) -> np.ndarray:
    """uint8 [rows, columns, 3]: ink by the square root of alpha, so that faint fog is seen; stored macroblocks are blue."""
    ink = np.sqrt(rgba[..., 3:] / 255.0)
    behind, paper, full = (np.array(ImageColor.getrgb(colour), float) for colour in (STORED, PAPER, INK))
    return np.round(np.where(stored[..., None], behind, paper) * (1 - ink) + full * ink).astype(np.uint8)


def draw_sections(path: Path, cuts: Mapping[str, Section]) -> None:
    """Writes a PNG: a column for each section under its label; above its opacity, below its colours. Same scale for all."""
    require_plots()
    from matplotlib.figure import Figure

    low = np.min([cut.low for cut in cuts.values()], axis=0)
    high = np.max([cut.high for cut in cuts.values()], axis=0)
    down, across = SIDE * (high - low) / (high - low).max()
    figure = Figure((across * len(cuts), 2 * down + TITLE), layout="constrained")
    rows = figure.subplots(2, len(cuts), sharex=True, sharey=True, squeeze=False)
    for (label, cut), opacity, colours in zip(cuts.items(), *rows, strict=True):
        opacity.set_title(label, loc="left", fontsize=9, parse_math=False)
        edges = (cut.low[0], cut.high[0]) if cut.upward else (cut.high[0], cut.low[0])
        over_white = np.minimum(cut.rgba[..., :3].astype(int) + 255 - cut.rgba[..., 3:], 255).astype(np.uint8)
        for axes, picture in ((opacity, opacity_picture(cut.rgba, cut.stored)), (colours, over_white)):
            axes.imshow(picture, extent=(cut.low[1], cut.high[1], *edges))
            axes.set(xlim=(low[1], high[1]), ylim=(low[0], high[0])[:: 1 if cut.upward else -1], xticks=[], yticks=[])
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        figure.savefig(new, format="png", dpi=DPI, metadata={"Software": None})
