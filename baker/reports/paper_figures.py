"""The figures that the SNeRG paper and its authors' release print, to stand beside ours in tables; never measured here.

paper_figures.json holds them, by the parts of their names. In each row the mean over a kind's scenes comes first, then its
SCENES; null: not printed.
"""

import json
from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any, Literal

from training.scenes import Scene

Kind = Literal["synthetic", "forward", "real360"]
Printed = Sequence[float | None]
KINDS: Mapping[Kind, str] = {
    "synthetic": "its synthetic 360° scenes",
    "forward": "its real forward-facing scenes",
    "real360": "its real 360° scenes",
}
_PRINTED: dict[str, Any] = {}
for _name, _values in json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8")).items():
    *_parts, _last = _name.split("/")
    reduce(lambda table, part: table.setdefault(part, {}), _parts, _PRINTED)[_last] = _values
SCENES: Mapping[Kind, Sequence[str]] = _PRINTED["scenes"]
QUALITY: Mapping[Kind, Mapping[str, Mapping[str, Printed]]] = _PRINTED["quality"]  # by metric and row
QUALITY_MEANS: Mapping[str, Sequence[float]] = _PRINTED["quality_means"]  # of synthetic scenes, without single ones
# PSNR, SSIM, LPIPS, MB of table 3 and the appendix.
STORAGE: Mapping[Kind, Mapping[str, Sequence[float]]] = _PRINTED["storage"]
# Table 1 and the appendix: milliseconds a frame and GB on the graphics card, on a laptop with an 85 W AMD Radeon Pro 5500M.
MILLISECONDS: Mapping[str, Printed] = _PRINTED["milliseconds"]
GPU_GB: Mapping[str, Printed] = _PRINTED["gpu_gb"]
REAL_FPS: Mapping[Kind, Sequence[float]] = _PRINTED["real_fps"]  # of the real scenes, without a mean
# PSNR, SSIM, LPIPS, FPS, MB by voxels, of the appendix's table of resolutions.
RESOLUTION: Mapping[int, Sequence[float]] = {int(side): row for side, row in _PRINTED["resolution"].items()}
# PSNR, SSIM, LPIPS, watts, FPS and FPS per watt of table 4 and of the appendix's table of forward-facing scenes.
SPEED: Mapping[Kind, Mapping[str, Sequence[float]]] = _PRINTED["speed"]
RELEASE: Mapping[Kind, Mapping[str, Printed]] = _PRINTED["release"]  # PSNR in the authors' README, measured on TPUs
NAMES: Mapping[str, str] = {
    "jaxnerf-plus": "JAXNeRF+",
    "jaxnerf": "JAXNeRF",
    "tinyview": "JAXNeRF+ Tinyview",
    "deferred": "JAXNeRF+ Deferred",
    "diffuse": "JAXNeRF+ Diffuse",
    "snerg": "SNeRG (PNG)",
}


def kind_of(scene: Scene) -> Kind:
    return "forward" if scene.ndc else "synthetic" if scene.kind == "blender" else "real360"


def place_of(kind: Kind, name: str) -> int:
    """Where a scene of this name stands in rows of its kind; 0, the mean, where the paper has no such scene."""
    plain = name.lower().replace("_", "").replace("-", "").replace(" ", "")
    return 1 + SCENES[kind].index(plain) if plain in SCENES[kind] else 0


def whose(kind: Kind, name: str) -> str:
    """Of what the paper's figures are that stand beside those of a scene."""
    return f"the same scene, {name}" if place_of(kind, name) else f"the mean of {KINDS[kind]}"


def quality(kind: Kind, name: str, row: str) -> dict[str, float | None] | None:
    """psnr, ssim, lpips of a row of the paper's quality tables, for a scene or its kind's mean. None where it has none."""
    place = place_of(kind, name)
    if row in QUALITY_MEANS:
        return dict(zip(("psnr", "ssim", "lpips"), QUALITY_MEANS[row], strict=True)) if kind == "synthetic" else None
    if row not in QUALITY[kind]["psnr"]:
        return None
    return {metric: rows[row][place] for metric, rows in QUALITY[kind].items()}


def release(kind: Kind, name: str, row: str) -> float | None:
    """PSNR of a row as the release reports it."""
    rows = RELEASE.get(kind, {})
    return rows[row][place_of(kind, name)] if row in rows else None


def performance(kind: Kind, name: str, row: str) -> dict[str, float | None] | None:
    """ms and gpu_gb of a row of table 1; fps where only that is printed."""
    place = place_of(kind, name)
    if kind == "synthetic" and row in MILLISECONDS:
        return {"ms": MILLISECONDS[row][place], "gpu_gb": GPU_GB[row][place]}
    if kind != "synthetic" and row == "ours" and place:
        return {"fps": REAL_FPS[kind][place - 1]}
    return None


def storage(kind: Kind, row: str) -> dict[str, Any] | None:
    """psnr, ssim, lpips and mb of a row of the storage tables; means over a kind's scenes."""
    printed = STORAGE[kind].get(row)
    return None if printed is None else dict(zip(("psnr", "ssim", "lpips", "mb"), printed, strict=True))
