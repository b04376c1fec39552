"""Plan: how a scene is made of photographs or of a training run, and which command does it.

The viewer knows neither trainer nor baker; it starts their commands (viewer.core.tasks). A folder that snerg-make has
written into, DIR with DIR/run, is gone on with where it was stopped.
"""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from console import UserError
from console.child_process import module_command
from console.json_text import read_json_file
from training.scenes.scene import Box, Direction
from training.scenes.sources import FEWEST, Source, is_film
from viewer.core.files import POSED, REPORT, found_poses, why_not_writable
from viewer.features.making.survey import Survey, poser_missing, trainer_missing

Subject = Literal["scene", "run"]
RESOLUTIONS = (256, 512, 1000)  # voxels a side, of a bake; snerg-make has one for each preset
PREVIEW_FILE = "preview.zip"  # in the folder for the results; equals baker.baking.to_pack.PREVIEW_FILE
PREVIEWS = "--previews=30"  # seconds between them
OURS = ("--no-view", "--poses-only", PREVIEWS)  # what a person who types the command leaves out


@dataclass
class Plan:
    """None leaves a choice to the preset, or to the command."""

    subject: Subject
    source: Path  # the scene's or the run's folder
    out: Path  # of a scene, the folder for run/ and pack/; of a run, the pack itself
    preset: str = "normal"
    downscale: int | None = None
    resolution: int | None = None  # voxels a side
    spherify: bool = False
    masks: bool | None = None  # None cuts out where there is a mask for each photograph
    steps: int | None = None
    aabb: Box | None = None  # the box to train, training frame
    up: Direction | None = None  # likewise
    poses_only: bool = False  # no more is begun than finding poses
    survey: Survey | None = field(default=None, repr=False)  # of the scene's photographs
    attempt: dict | None = field(default=None, repr=False)  # an older run in `out`, gone on with: see _description
    place_problem: str | None = field(default=None, repr=False)  # why nothing can be written there

    def __post_init__(self) -> None:
        self.choose(self.out)

    def choose(self, out: Path) -> None:
        """Takes another folder for the results."""
        self.out, self.attempt = out, None
        self.place_problem = why_not_writable(self.log.parent)
        if self.subject == "scene" and (self.run / "config.json").is_file():
            with contextlib.suppress(UserError):
                self.attempt = _description(self.run)

    @classmethod
    def of(cls, subject: Subject, path: Path) -> Plan:
        """How `path` would be made if nothing else is said. UserError where an unfinished run's description is broken."""
        path = path.resolve()
        if subject == "scene":
            if found_poses(path):
                source = _photographs_of(path / POSED)
                return cls("scene", source, path, survey=Survey(source, anew=source != path / POSED))
            out = _beside(path, f"{path.stem if is_film(path) else path.name}-snerg")
            return cls("scene", path, out, survey=Survey(path))
        if (path / "run").is_dir() and not (path / "config.json").is_file():  # snerg-make's DIR
            scene = _description(path / "run")["scene"]
            if scene and Path(scene).is_dir():
                return cls("scene", Path(scene), path, survey=Survey(Path(scene)))
            path = path / "run"
        name = "pack" if path.name == "run" else f"{path.name}-pack"
        return cls("run", path, _beside(path, name))

    @property
    def bare(self) -> Source | None:
        """The photographs or the film whose poses must be found first."""
        return None if self.survey is None else self.survey.bare

    def find_anew(self, anew: bool) -> None:
        """Whether poses are found although there are some."""
        if self.survey is not None:
            self.survey.cancel()
        self.survey = Survey(self.source, anew)

    @property
    def posed(self) -> Path:
        """The scene with poses, there already or to come."""
        return self.source if self.bare is None else self.out / POSED

    @property
    def stages(self) -> tuple[str, ...]:
        """What the command does, one after the other."""
        return ("Poses", "Training", "Baking") if self.bare is not None else ("Training", "Baking")

    @property
    def masked(self) -> bool:
        """Whether there is a mask for each photograph, at the size that is trained on."""
        survey = self.survey
        return survey is not None and (self.downscale or survey.automatic.get(self.preset, 1)) in survey.masked

    @property
    def cut_out(self) -> bool:
        """Whether only what the masks show is kept: as it was asked for, but never without the masks."""
        return bool(self.masks) if self.survey is None else self.masked and self.masks is not False

    @property
    def name(self) -> str:
        return self.source.parent.name if self.source.name == "run" else self.source.name

    @property
    def pack(self) -> Path:
        return self.out / "pack" if self.subject == "scene" else self.out

    @property
    def preview_file(self) -> Path:
        """Where the child keeps what is trained so far."""
        return self.out / PREVIEW_FILE

    @property
    def log(self) -> Path:
        """What the command prints goes there."""
        return self.out / "make.log" if self.subject == "scene" else self.out.with_name(f"{self.out.name}.log")

    @property
    def run(self) -> Path:
        return self.out / "run" if self.subject == "scene" else self.source

    @property
    def can_be_checked(self) -> bool:
        """Whether there are photographs to check that nothing was trained on, and a place for the page about them."""
        found = self.survey is not None and self.survey.finished and self.survey.error is None
        missing = trainer_missing() or (self.bare is not None and poser_missing(self.bare) is not None)
        return found and not missing and self.place_problem is None and self.attempt is None

    def problem(self) -> str | None:
        """Why it cannot be begun as it is planned; None where nothing speaks against it."""
        if trainer_missing():
            return "Only the viewer is installed. pip install 'snerg[train]' adds the trainer and the baker."
        if self.survey is not None and self.survey.error is not None:
            return str(self.survey.error)
        if self.bare is not None and (extras := poser_missing(self.bare)) is not None:
            return f"This installation cannot find camera poses. pip install 'snerg[{extras}]' adds what does."
        preview = None if self.survey is None else self.survey.preview
        if preview is not None and preview.error:
            return preview.error
        if preview is not None and preview.used is not None and preview.used < FEWEST:
            what = "frames differ" if preview.of_film else f"of {preview.count} photographs can be used"
            return f"Only {preview.used} {what}. Finding camera poses takes at least {FEWEST}."
        if self.subject == "scene" and self.attempt is not None:
            other = self.attempt["scene"]
            if other and Path(other) not in (self.source, self.out / POSED):
                return f"There is a run of another scene in {self.out}; choose another folder."
        return None

    def attempt_text(self) -> str:
        """How far the earlier attempt is, "" where there is none."""
        if self.attempt is None:
            if self.bare is not None and found_poses(self.out):
                return "The camera poses in this folder are used, unless the photographs were changed since."
            begun = (self.out / "posing").is_dir()
            return "Finding camera poses has begun in this folder. It continues." if begun else ""
        steps = [int(path.stem.removeprefix("step_")) for path in (self.run / "checkpoints").glob("step_*.safetensors")]
        total = self.attempt["steps"]
        if steps and max(steps) >= total:
            return "The folder has a trained run. It is baked with its own settings."
        done = f"at step {max(steps):,} of {total:,}" if steps else "before its first checkpoint"
        return f"The folder has an unfinished run, {done}. It continues with its own settings."

    def command(self) -> list[str]:
        """Program and arguments that make it; `typed` is the same for a person."""
        return module_command("snerg", "make" if self.subject == "scene" else "bake", *self._arguments())

    def typed(self) -> str:
        """The command line, to be typed on another machine, say."""
        program = "snerg-make" if self.subject == "scene" else "snerg-bake"
        return shlex.join([program, *(word for word in self._arguments() if word not in OURS)])

    def _arguments(self) -> list[str]:
        words = [str(self.source), "--out", str(self.out)]
        options: dict[str, object] = {"resolution": self.resolution}
        if self.subject == "scene":
            words += ["--preset", self.preset, "--no-view", PREVIEWS]
            words += ["--spherify"] * self.spherify + ["--masks"] * self.cut_out + ["--poses-only"] * self.poses_only
            words += ["--find-poses"] * (self.survey is not None and self.survey.anew and self.survey.posed)
            aabb, up = (value and ",".join(f"{number:g}" for number in value) for value in (self.aabb, self.up))
            options = {"aabb": aabb, "up": up, "downscale": self.downscale, "steps": self.steps, **options}
        for name, value in options.items():
            words += [] if value is None else [f"--{name}", str(value)]
        return words


def _beside(path: Path, name: str) -> Path:
    """A folder called `name` beside `path`, or in the user's home where nothing may be written there."""
    return path.parent / name if why_not_writable(path.parent) is None else Path.home() / name


def _photographs_of(posed: Path) -> Path:
    """The photographs or the film that the poses in a folder were found of; the folder itself where these are gone."""
    try:
        named = read_json_file(posed / REPORT)["photographs"]
        source = Path(named) if isinstance(named, str) else posed
        return source if source.is_absolute() and source.exists() else posed
    except (OSError, ValueError, KeyError, TypeError):
        return posed


def _description(run: Path) -> dict:
    """What a run's config.json says of "scene" (a folder, "" where it does not say) and "steps" (in all)."""
    file = run / "config.json"
    try:
        values = read_json_file(file)
        return {"scene": str(values.get("scene", "")), "steps": int(values.get("config", {}).get("steps", 0))}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise UserError("the run's description cannot be read", where=file, found=str(error)[:100]) from error
