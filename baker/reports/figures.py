"""The paper's figures of quality: the same crop of several pictures and the photograph, side by side, PSNR below each.

Of the view that differs most between the first and the last picture, the square whose differences are largest: where there is
something to see. Pictures are those that scoring left in the report's folder.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from baker.reports.report_cache import Study
from console.atomic import replacing
from console.plots import INK, PAPER

SHARE = 0.3  # of the picture's shorter side: the crop's
PANEL, GAP, CAPTION, LETTERS = 240, 10, 40, 34  # pixels of a panel's side, between panels, below one; letters in a line
FIGURES: Mapping[str, Sequence[str]] = {  # rows, from left to right; those that were not measured are left out
    "ablation": ("jaxnerf-plus", "tinyview", "deferred", "field", "snerg", "ours-compact", "diffuse"),
    "fine-tuning": ("float", "8-bit", "snerg", "ours-compact"),
}
SHORT = {
    "float": "SNeRG (float)", "8-bit": "no fine-tuning", "snerg": "SNeRG (PNG)", "ours-compact": "ours", "diffuse": "Diffuse",
    "jaxnerf-plus": "JAXNeRF+", "tinyview": "Tinyview", "deferred": "Deferred",
}  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """A picture [H, W, 3], uint8, and what is said of it."""

    picture: np.ndarray
    caption: str


def draw_figure(
    study: Study, rows: Sequence[Mapping[str, Any]], names: Sequence[str], path: Path
) -> dict[str, Any] | None:
    """Writes the panels of rows `names` that have pictures, and the photograph; None where fewer than two have.

    Returns {"picture", "view", "box": [left, top, side], "panels": [{"row", "label", "psnr"}]}.
    """
    by_name = {row["row"]: row for row in rows}
    shown = [by_name[name] for name in names if "pictures" in by_name.get(name, {})]
    if len(shown) < 2:
        return None
    views = list(shown[0]["views"])
    view = max(range(len(views)), key=lambda i: abs(shown[0]["views"][views[i]] - shown[-1]["views"][views[i]]))
    pairs = [_pictures(study.out / row["pictures"] / f"{study.stem(view)}.png") for row in shown]
    box = _most_different(pairs[0][0], pairs[-1][0], pairs[0][1])
    panels, labels = [], []
    for row, (picture, _) in zip(shown, pairs, strict=True):
        psnr = row["views"][views[view]]
        label = SHORT.get(row["row"]) or str(row["label"])
        panels.append(Panel(picture, f"{label} ({psnr:.2f} dB)"))
        labels.append({"row": row["row"], "label": label, "psnr": psnr})
    panels.append(Panel(pairs[0][1], "photograph"))
    draw_panels(panels, box, path)
    return {"picture": path.name, "view": views[view], "box": list(box), "panels": labels}


def _pictures(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The picture and the photograph of a comparison that baker.reports.evaluation wrote; see save_comparison."""
    with Image.open(path, formats=["PNG"]) as opened:
        whole = np.asarray(opened.convert("RGB"))
    width = whole.shape[1] // 3
    return whole[:, :width], whole[:, width : 2 * width]


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


def draw_panels(panels: Sequence[Panel], box: tuple[int, int, int], path: Path) -> None:
    """A row of panels: the crop, whole pixels enlarged; the whole picture above, with the crop's frame."""
    left, top, side = box
    height, width = panels[0].picture.shape[:2]
    small = PANEL, round(PANEL * height / width)
    sheet = Image.new("RGB", (GAP + len(panels) * (PANEL + GAP), small[1] + PANEL + 3 * GAP + CAPTION), PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    for i, panel in enumerate(panels):
        x, picture = GAP + i * (PANEL + GAP), Image.fromarray(np.ascontiguousarray(panel.picture))
        sheet.paste(
            picture.resize(small, Image.Resampling.BOX if width > PANEL else Image.Resampling.NEAREST), (x, GAP)
        )
        scale = PANEL / width
        frame = [x + left * scale, GAP + top * scale, x + (left + side) * scale, GAP + (top + side) * scale]
        pen.rectangle([round(edge) for edge in frame], outline=(207, 74, 34))
        crop = picture.crop((left, top, left + side, top + side))
        sheet.paste(crop.resize((PANEL, PANEL), Image.Resampling.NEAREST), (x, small[1] + 2 * GAP))
        for line, text in enumerate(_lines(panel.caption)):
            pen.text((x, small[1] + PANEL + 2 * GAP + 4 + 15 * line), text, fill=INK, font=font)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new:
        sheet.save(new, format="PNG", optimize=True)


def _lines(caption: str) -> list[str]:
    """At most two lines, broken at a space."""
    if len(caption) <= LETTERS:
        return [caption]
    cut = caption.rfind(" ", 0, LETTERS)
    cut = cut if cut > 0 else LETTERS
    return [caption[:cut], caption[cut:].strip()[:LETTERS]]
