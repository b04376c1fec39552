"""How a scene shall be made of photographs or of a training run: what is there, what can be chosen, which command does it.

The viewer knows neither trainer nor baker; it starts their commands (viewer.app.command_process). A folder that snerg-make has
written into, DIR with DIR/run, is gone on with where it was stopped.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import shlex
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from console import Notice, UserError
from console.json_text import read_json_file
from console.python_command import module_command
from training.scenes import Scene, load_scene
from training.scenes.pictures import picture_size
from training.scenes.presets import PRESETS
from training.scenes.read import has_poses, suggested_downscale
from training.scenes.scene import Box, Direction
from training.scenes.sources import FEWEST, Source, find_source, is_film
from viewer.app.background import Task
from viewer.app.bare_preview import BarePreview
from viewer.app.files import POSED, REPORT, found_poses, why_not_writable
from viewer.app.time_needed import TimeNeeded
from viewer.app.training_preview import EVERY_S, FILE

Subject = Literal["scene", "run"]
OFFERED = {name: preset for name, preset in PRESETS.items() if preset.title}
DOWNSCALES = (1, 2, 4, 8)
RESOLUTIONS = (256, 512, 1000)  # voxels a side, of a bake; snerg-make has one for each preset
KINDS = {"blender": "Blender", "llff": "LLFF", "transforms": "transforms.json", "colmap": "COLMAP"}
MASKED_KINDS = ("llff", "transforms", "colmap")  # layouts whose pictures may have masks beside them
PARTS = ("jax", "matplotlib", "numba", "optax", "safetensors", "scipy")  # the extra `train`
PREVIEWS = f"--previews={EVERY_S}"
OURS = ("--no-view", "--poses-only", PREVIEWS)  # what a person who types the command leaves out
MEASURES = True  # the time that a run takes here
POSES_FIRST = "Nothing says where the camera stood: that is found first."


def trainer_missing() -> bool:
    """Whether this installation is the viewer alone."""
    return any(importlib.util.find_spec(name) is None for name in PARTS)


def poser_missing(source: Source) -> str | None:
    """The extras that this installation lacks to find poses of photographs or of a film; None where it can."""
    needed = {"pycolmap": "poses", **({"av": "video"} if source.kind == "film" else {})}
    missing = [extra for name, extra in needed.items() if importlib.util.find_spec(name) is None]
    return ",".join(missing) or None


class Survey(Task[None]):
    """Reads a scene's description and its pictures' headers in a thread. Poll `finished`, then take the rest.

    error: why it is no scene that can be read. text: one line about it. kind: its layout, "" where it
    has no poses. sizes: width, height in pixels by downscale.
    automatic: the downscale of a preset that shrinks. forward: cameras (LLFF, COLMAP) that may be read as looking all around.
    masks: whether there are any. masked: the downscales at which there is one for each photograph. bare: photographs or a
    film without poses, which are found before training; None where there are poses. preview: of these, where this
    installation finds poses. time: that a run takes here, where this installation trains.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.time: TimeNeeded | None = None
        self.bare: Source | None = None
        self.preview: BarePreview | None = None
        self.error: Exception | None = None
        self.text = ""
        self.kind = ""
        self.notes: list[str] = []
        self.sizes: dict[int, tuple[int, int]] = {}
        self.automatic: dict[str, int] = {}
        self.forward = False
        self.masks = False
        self.masked: set[int] = set()
        self._closed = False
        with contextlib.suppress(UserError):  # several films: told by the thread
            self.bare = None if has_poses(path) else find_source(path)
        if self.bare is None:
            self.masks = any(path.glob("masks*"))
        super().__init__(self._read)

    @property
    def busy(self) -> bool:
        """Whether there will be more to see."""
        return not self.finished or any(each is not None and not each.finished for each in (self.preview, self.time))

    def news(self) -> bool:
        """Whether more of the preview, or of the time, is known since this was asked last."""
        return any([each.news() for each in (self.preview, self.time) if each is not None])

    def close(self) -> None:
        """Nobody asks any more."""
        self._closed = True
        for each in (self.preview, self.time):
            if each is not None:
                each.close()

    @property
    def choices(self) -> list[int]:
        """Downscales that differ in what they give, from the largest pictures to the smallest."""
        largest_first = sorted((-width, -downscale) for downscale, (width, _) in self.sizes.items())
        found: dict[int, int] = {}
        for width, downscale in largest_first:
            found.setdefault(width, -downscale)
        return [downscale for downscale in found.values() if downscale in DOWNSCALES]

    def size(self, preset: str, downscale: int | None) -> tuple[int, int] | None:
        """Pixels of the photographs that a run with these options trains on; None where it is not known."""
        return self.sizes.get(downscale or self.automatic.get(preset, 1))

    def _read(self) -> None:
        try:
            self.bare = self.bare or (None if has_poses(self.path) else find_source(self.path))
            if self.bare is not None:
                self._look_at_bare(self.bare)
                self.text = " ".join([self.text, *(f"{note}." for note in self.bare.notes)])
                return
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                scene = load_scene(self.path)
            self.notes = [str(warning.message) for warning in caught if issubclass(warning.category, Notice)]
            self.automatic = {
                name: suggested_downscale(self.path, preset.longest_side)
                for name, preset in OFFERED.items()
                if preset.longest_side is not None
            }
            for downscale in {*DOWNSCALES, *self.automatic.values()}:
                with contextlib.suppress(UserError), warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    self.sizes[downscale] = _size(load_scene(self.path, downscale=downscale))
                    if scene.kind in MASKED_KINDS:
                        load_scene(self.path, downscale=downscale, masks=True)
                        self.masked.add(downscale)
            self.masks = self.masks or bool(self.masked)
            self.forward, self.kind = scene.ndc, scene.kind
            width, height = _size(scene)
            count = sum(len(photographs) for photographs in scene.splits.values())
            seen = "forward-facing" if scene.ndc else "360°"
            kind = KINDS.get(scene.kind, scene.kind)
            self.text = f"{count} photographs of {width} × {height}, {seen}  ({kind})"
            self._begin_time()
        except Exception as error:  # told in the dialog
            self.error = error

    def _look_at_bare(self, source: Source) -> None:
        """What the first photograph tells of all. UserError where there are too few."""
        if source.kind == "film":
            self._begin_preview(source)
            self.text = f"A film of {source.files[0].stat().st_size / 1e6:,.0f} MB. {POSES_FIRST}"
            return
        count, size = len(source.files), None
        if count < FEWEST:
            raise UserError("too few photographs to find camera poses", where=self.path, expected=f"at least {FEWEST}",
                            found=count)  # fmt: skip
        self._begin_preview(source)
        with contextlib.suppress(UserError):  # HEIC, say: what cannot be read is told by whoever finds the poses
            size = picture_size(source.files[0])
        if size is None:
            self.text = f"{count} photographs. {POSES_FIRST}"
            return
        self.text = f"{count} photographs of {size[0]} × {size[1]}. {POSES_FIRST}"
        for name, preset in OFFERED.items():
            if preset.longest_side is not None:
                self.automatic[name] = max(math.ceil(max(size) / preset.longest_side), 1)
        for downscale in {*DOWNSCALES, *self.automatic.values()}:
            if min(size) >= downscale:
                self.sizes[downscale] = (size[0] // downscale, size[1] // downscale)
        self.masks = source.masks is not None
        if self.masks and all(source.mask_of(file) is not None for file in source.files):
            self.masked = set(self.sizes)
        self._begin_time()

    def _begin_time(self) -> None:
        if MEASURES and not self._closed and not trainer_missing():
            after = self.preview.result if self.preview is not None else lambda: None
            self.time = TimeNeeded([max(size) for size in self.sizes.values()], after)

    def _begin_preview(self, source: Source) -> None:
        if poser_missing(source) is None and not self._closed:
            with contextlib.suppress(UserError):  # no temporary folder: there is no preview then
                self.preview = BarePreview(source)
            if self._closed and self.preview is not None:  # in the meantime
                self.preview.close()


def _size(scene: Scene) -> tuple[int, int]:
    camera = next(iter(scene.splits.values()))[0].camera
    return camera.width, camera.height


@dataclass
class Plan:
    """source: the scene's or the run's folder. out: of a scene, the folder for run/ and pack/; of a run, the pack itself.

    downscale, resolution (voxels a side), steps: None leaves them to the preset, or to the command. masks: None cuts out
    where there is a mask for each photograph. aabb: the box to train, and up: what is up, training frame; None for the
    reader's own. poses_only: no more is begun than finding poses. survey: of the scene's photographs. attempt: what an
    older run in `out` says of itself; it is gone on with. place_problem: why nothing can be written there.
    """

    subject: Subject
    source: Path
    out: Path
    preset: str = "normal"
    downscale: int | None = None
    resolution: int | None = None
    spherify: bool = False
    masks: bool | None = None
    steps: int | None = None
    aabb: Box | None = None
    up: Direction | None = None
    poses_only: bool = False
    survey: Survey | None = field(default=None, repr=False)
    attempt: dict | None = field(default=None, repr=False)
    place_problem: str | None = field(default=None, repr=False)

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
        if subject == "scene" and found_poses(path):
            source = _photographs_of(path / POSED)
            return cls("scene", source, path, survey=Survey(source))
        if subject == "scene":
            return cls(
                "scene", path, _beside(path, f"{path.stem if is_film(path) else path.name}-snerg"), survey=Survey(path)
            )
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

    @property
    def posed(self) -> Path:
        """The scene with poses, there already or to come."""
        return self.source if self.bare is None else self.out / POSED

    @property
    def has_points(self) -> bool:
        """Whether there is a first look at it, once it has poses."""
        return self.bare is not None or (self.survey is not None and self.survey.kind == "colmap")

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
        """What it is called while it is made."""
        return self.source.parent.name if self.source.name == "run" else self.source.name

    @property
    def pack(self) -> Path:
        """Where the finished pack is."""
        return self.out / "pack" if self.subject == "scene" else self.out

    @property
    def preview_file(self) -> Path:
        """Where the child keeps what is trained so far."""
        return self.out / FILE

    @property
    def log(self) -> Path:
        """What the command prints goes there."""
        return self.out / "make.log" if self.subject == "scene" else self.out.with_name(f"{self.out.name}.log")

    @property
    def run(self) -> Path:
        """The training run."""
        return self.out / "run" if self.subject == "scene" else self.source

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
        room = "baker.commands.make" if self.subject == "scene" else "baker.commands.bake"
        return module_command(room, *self._arguments())

    def typed(self) -> str:
        """The command line, to be typed on another machine, say."""
        program = "snerg-make" if self.subject == "scene" else "snerg-bake"
        return shlex.join([program, *(word for word in self._arguments() if word not in OURS)])

    def _arguments(self) -> list[str]:
        words = [str(self.source), "--out", str(self.out)]
        names = ["resolution"]
        if self.subject == "scene":
            words += ["--preset", self.preset, "--no-view", PREVIEWS]
            names = ["downscale", "steps", "resolution"]
            words += ["--spherify"] * self.spherify + ["--masks"] * self.cut_out + ["--poses-only"] * self.poses_only
            for name in ("aabb", "up"):
                value = getattr(self, name)
                words += [] if value is None else [f"--{name}", ",".join(f"{number:g}" for number in value)]
        for name in names:
            if (value := getattr(self, name)) is not None:
                words += [f"--{name}", str(value)]
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
