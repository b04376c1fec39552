"""Options of snerg-report, and what they ask for. No JAX here, so that --help is quick."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from baker.baking.config import Quality
from console import UserError
from console.command_line import parse_size
from training.scenes.scene import Box
from training.scenes.scene_options import parse_box

TABLES = ("quality", "storage", "performance", "resolution", "real", "sparsity")


@dataclass(frozen=True)
class ReportOptions:
    """What a report of a run is about, and what its tables show."""

    out: Path
    """Folder for the report. Packs, scores and pictures stay in it and are reused."""
    scene: Path | None = None
    """Folder of the photographs, if they moved. The default is where the run read them."""
    split: str = "test"
    """Which photographs to use: test, train or val."""
    views: int = 0
    """Score at most this many of them, evenly spread; 0 for all."""
    tables: str | None = None
    """Tables to make, separated by commas: quality, storage, performance, resolution, real, sparsity. The default is all; real
    only for scenes that are not synthetic."""
    resolution: int | None = None
    """Voxels along the longest side, for all tables but resolution. The default is the paper's: 1000 for synthetic scenes, 1300
    for photographs."""
    resolutions: str = "1000,750,500"
    """Voxels along the longest side, separated by commas, for the table resolution."""
    bake: Literal["paper", "snerg"] = "paper"
    """Which bake the tables storage and resolution are of: paper (as the paper writes), or snerg (our default settings)."""
    quality: str = "full"
    """Rows of our own bake in the table quality, separated by commas: draft, compact, full (our default)."""
    aabb: str | None = None
    """Box that all packs are baked of, x0,y0,z0,x1,y1,z1 in the training frame, and photographs and pictures are compared only
    where the paper's bake of it is opaque: the paper's procedure for real 360 degree scenes, which are trained beyond it."""
    against: Path | None = None
    """A second run of the same scene, trained without the sparsity loss."""
    baselines: str | None = None
    """Folders of further runs of the same scene, separated by commas: of the presets jaxnerf-plus, jaxnerf, tinyview, deferred
    and diffuse. Each fills its row."""
    frames: int = 150
    """Number of frames to time."""
    size: str | None = None
    """Picture size of timed frames, WIDTHxHEIGHT in pixels. The default is that of snerg-bench."""
    nominal_watts: float | None = None
    """Nominal power of the graphics card, for frames per second per watt as the paper counts them (85 for its laptop), beside
    those that are measured."""
    quick: bool = False
    """For the table storage: measure only the default quality of each codec."""

    def check(self) -> None:
        """UserError for what makes no sense, before anything is read."""
        _ = self.qualities, self.sides, self.pixels, self.box
        self.tables_of("synthetic")
        watts = self.nominal_watts
        if watts is not None and not watts > 0:
            raise UserError("is no power", where="--nominal-watts", expected="watts, more than 0", found=watts)
        if self.frames < 1 or self.views < 0 or (self.resolution is not None and self.resolution < 1):
            raise UserError("is too small", where="--resolution, --frames or --views")

    def tables_of(self, kind: str) -> list[str]:
        """Which tables to make of a scene of this kind (baker.reports.paper_figures.Kind)."""
        default = ",".join(name for name in TABLES if name != "real" or kind != "synthetic")
        return _chosen(default if self.tables is None else self.tables, TABLES, "--tables")

    @property
    def qualities(self) -> list[Quality]:
        return _chosen(self.quality, get_args(Quality), "--quality")

    @property
    def sides(self) -> list[int]:
        """The resolutions of the table of them."""
        words = _words(self.resolutions)
        if not words or not all(word.isdecimal() for word in words):
            raise UserError("is not a list of whole numbers", where="--resolutions", expected="such as 1000,500",
                            found=repr(self.resolutions))  # fmt: skip
        return sorted({int(word) for word in words})

    @property
    def pixels(self) -> tuple[int, int] | None:
        """Width and height of timed frames; None: the protocol's."""
        return parse_size(self.size) if self.size else None

    @property
    def baseline_folders(self) -> list[Path]:
        return [Path(word) for word in _words(self.baselines or "")]

    @property
    def box(self) -> Box | None:
        """`aabb` in numbers."""
        return parse_box(self.aabb)


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _chosen(text: str, known: Sequence[str], where: str) -> list[Any]:
    names = list(dict.fromkeys(_words(text)))
    wrong = [name for name in names if name not in known]
    if wrong or not names:
        found = wrong[0] if wrong else "none"
        raise UserError("is not a list of these", where=where, expected=", ".join(known), found=found)
    return sorted(names, key=known.index)
