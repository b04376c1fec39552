"""From photographs to a scene: read, train, bake, evaluate."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from snerg._camera import Camera, camera_of, check_choice
from snerg._errors import SnergError, with_snerg_errors
from snerg._scene import Codec, Scene, load

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from training.scenes import SceneOptions

Method = Literal["snerg", "paper"]
Quality = Literal["draft", "compact", "full"]
Preset = Literal["quick", "normal", "full", "paper", "small", "tiny", "deferred", "diffuse", "no-sparsity"]


@dataclass(frozen=True)
class Progress:
    """How far a piece of work is."""

    title: str
    """What is being done: "training"."""
    done: float
    """Units that are done, of `total`."""
    total: float
    """All units."""
    seconds_left: float | None
    """An estimate; None while too little is known."""
    metrics: Mapping[str, float]
    """Figures by name: `psnr` (dB), `rays_per_second`."""


OnProgress = Callable[[Progress], None]


@dataclass(frozen=True)
class Photographs:
    """Photographs with camera poses, from `read_photographs`. Pictures are decoded when asked for."""

    path: Path
    """The folder with the poses."""
    cameras: tuple[Camera, ...]
    """Their cameras, in the frame "world"."""
    _loaders: tuple[Callable[[], NDArray[np.float32]], ...] = field(repr=False)
    _options: SceneOptions = field(repr=False)
    _chosen_size: bool = field(repr=False)

    def __len__(self) -> int:
        """How many there are."""
        return len(self.cameras)

    @with_snerg_errors
    def picture(self, index: int) -> NDArray[np.float32]:
        """One of them, float32 [h, w, 4] in 0 ... 1: sRGB and straight alpha.

        Raises:
            SnergError: Where the file cannot be read.
        """
        return self._loaders[index]()


@dataclass(frozen=True)
class Run:
    """A trained field on disk, from `train`."""

    path: Path
    """Its folder."""
    step: int
    """Steps that were trained."""
    _loaded: Any = field(repr=False, default=None)


@dataclass(frozen=True)
class ViewScores:
    """How well one photograph is shown, or the mean of all; see `Scores`."""

    name: str
    """Of the photograph."""
    psnr: float
    """Peak signal-to-noise ratio, dB."""
    psnr_matched: float
    """The same after a gain and an offset for each colour channel, fitted to the photograph, dB."""
    ssim: float
    """Structural similarity, at most 1."""
    lpips: float | None
    """Perceptual distance, from 0; None where its weights are not installed."""


@dataclass(frozen=True)
class Scores(ViewScores):
    """How well photographs are shown: means over `views`."""

    views: tuple[ViewScores, ...]
    """One for each photograph."""


@contextmanager
def _reporting(on_progress: OnProgress | None) -> Iterator[None]:
    """Progress goes to `on_progress`; to stderr where it is None."""
    if on_progress is None:
        yield
        return
    from console.progress import reported_to

    with reported_to(lambda r: on_progress(Progress(r.title, r.done, r.total, r.seconds_left, r.metrics))):
        yield


def _check_photographs(photographs: object) -> None:
    if not isinstance(photographs, Photographs):
        found, remedy = type(photographs).__name__, "read_photographs reads a folder of them"
        raise SnergError("are no snerg.Photographs", where="photographs", found=found, remedy=remedy)


@with_snerg_errors
def read_photographs(
    folder: str | Path,
    *,
    poses_to: str | Path | None = None,
    downscale: int | None = None,
    masks: bool = False,
    on_progress: OnProgress | None = None,
) -> Photographs:
    """Reads photographs with camera poses: Blender, LLFF, transforms.json, COLMAP.

    Args:
        folder: Of the photographs, or a film where poses are to be found.
        poses_to: Where photographs without poses, or a film, are made into a folder with poses, by COLMAP's pipeline (extra
            `poses`; of films also `video`). Poses that are there already are used.
        downscale: Divide width and height by this whole number. By default `train` chooses it by its preset.
        masks: Cut the object out with the masks beside the pictures.
        on_progress: Called with the progress of finding poses, which stderr shows otherwise.

    Raises:
        SnergError: Where there are no photographs or no poses, or they cannot be read.
    """
    from training.scenes import SceneOptions, load_scene

    path = Path(folder)
    if poses_to is not None:
        from training.posing.find import posed_scene

        with _reporting(on_progress):
            path = posed_scene(path, Path(poses_to))
    options = SceneOptions(1 if downscale is None else downscale, masks=masks)
    shots = [(photo, split) for split, some in load_scene(path, options).splits.items() for photo in some]
    cameras = tuple(camera_of(photo.camera, photo.name, split) for photo, split in shots)
    return Photographs(path, cameras, tuple(photo.load for photo, _ in shots), options, downscale is not None)


@with_snerg_errors
def train(
    photographs: Photographs,
    out: str | Path,
    *,
    preset: Preset = "normal",
    steps: int | None = None,
    seed: int = 0,
    resume: bool = False,
    on_progress: OnProgress | None = None,
) -> Run:
    """Trains a radiance field. Needs the extra `train`; JAX runs in this process.

    Args:
        photographs: To train on.
        out: Folder of the run, which must be new or empty unless `resume`.
        preset: Named settings, as of snerg-make; docs/commands.md has the table.
        steps: Number of steps, in place of the preset's.
        seed: Of all random numbers.
        resume: Continue the run in `out` with its own settings.
        on_progress: Called in this thread, a few times a second; what it raises ends the training. Without it, stderr shows
            the progress.

    Raises:
        SnergError: Where the photographs, the folder or a setting is of no use, or training diverges.
    """
    check_choice("preset", preset, Preset)
    _check_photographs(photographs)
    from training.libraries import begin_libraries

    begin_libraries()
    from training.config import PRESETS as CONFIGS
    from training.config import require_valid
    from training.loop import train as train_run
    from training.run import read_description
    from training.scenes.presets import PRESETS
    from training.scenes.read import suggested_downscale

    out, stored = Path(out), read_description(Path(out)) if resume else None
    config = replace(CONFIGS[preset], seed=seed) if stored is None else stored.config
    config = config if steps is None else replace(config, steps=steps)
    require_valid(config)
    options = photographs._options
    if stored is None and not photographs._chosen_size:
        options = replace(options, downscale=suggested_downscale(photographs.path, PRESETS[preset].longest_side))
    with _reporting(on_progress):
        run = train_run(photographs.path, out, config, options, resume=stored)
    return Run(out, run.step, run)


@with_snerg_errors
def bake(
    run: Run | str | Path,
    out: str | Path,
    *,
    method: Method = "snerg",
    resolution: int | None = None,
    quality: Quality = "full",
    codec: Codec = "png",
    on_progress: OnProgress | None = None,
) -> Scene:
    """Bakes a run into a pack, and opens it. Needs the extra `train`. The arguments are options of snerg-bake.

    Args:
        run: A run, or its folder.
        out: Folder or FILE.zip of the pack. An older pack there is replaced when the new one is complete.
        method: `snerg`, or what the paper writes.
        resolution: Voxels along the longest side. The default follows from the size of the photographs.
        quality: `draft` (not tuned), `full` (tuned, 8 bits) or `compact` (30 % fewer bytes, about 0.1 dB less).
        codec: `png` and `webp` lose nothing; the others are smaller.
        on_progress: As of `train`.

    Raises:
        SnergError: Where the run cannot be baked, or the pack not be written.
    """
    for where, value, choices in (("method", method, Method), ("quality", quality, Quality), ("codec", codec, Codec)):
        check_choice(where, value, choices)
    from training.libraries import begin_libraries

    begin_libraries()
    from baker.baking.config import BakeConfig
    from baker.baking.to_pack import bake_to
    from scenepack.writer import check_target
    from training.run import load_run

    check_target(Path(out))
    config = BakeConfig(resolution, method, quality)
    config.check()
    with _reporting(on_progress):
        loaded = run._loaded or load_run(run.path) if isinstance(run, Run) else load_run(run)
        bake_to(loaded, config, Path(out), codec, last=not isinstance(run, Run), say=lambda line: None)
    return load(out)


@with_snerg_errors
def evaluate(
    subject: Scene | Run | str | Path,
    photographs: Photographs,
    *,
    split: str = "test",
    on_progress: OnProgress | None = None,
) -> Scores:
    """Compares a scene (rendered with OpenGL) or a run (by the field itself) with photographs. Needs the extra `train`.

    Args:
        subject: A scene, a run, or the path of one, on disk.
        photographs: To compare with, at the size at which they were read.
        split: Which of them: "test", "train" or "val".
        on_progress: As of `train`.

    Raises:
        SnergError: Where the subject cannot be opened, or there are no such photographs.
    """
    _check_photographs(photographs)
    from training.libraries import begin_libraries

    begin_libraries()
    from baker.reports.evaluation import evaluate as measure
    from baker.reports.evaluation import reading_of
    from training.scenes import load_scene

    path = Path(subject) if isinstance(subject, str | Path) else subject.path
    options = replace(photographs._options, **{key: value for key, value in reading_of(path).items() if value})
    with _reporting(on_progress):
        found = measure(path, load_scene(photographs.path, options), split)
    means = {key: found[key] for key in ("psnr", "psnr_matched", "ssim", "lpips")}
    views = tuple(ViewScores(**view) for view in found["views"])
    return Scores(f"mean of {len(views)}", **means, views=views)
