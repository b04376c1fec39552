"""A run on disk, config.json and checkpoints/, and in memory.

config.json holds the TrainConfig, the scene's folder, how that is read, and provenance. Photographs -> (load_scene) Scene ->
(make_dataset) RayDataset -> (make_method) Method -> state, from the newest checkpoint.
"""

import json
import math
import os
import platform
import time
from dataclasses import asdict, dataclass, field, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

from console import UserError, progress
from console.atomic import is_leftover, write_file
from console.json_text import read_json_file
from training.checkpoints import list_checkpoints, read_newest_checkpoint, writing
from training.config import TrainConfig, from_json, require_valid
from training.dataset import RayDataset, make_dataset
from training.devices import agree, is_writer, together
from training.method import Method
from training.posing.depths import with_depths
from training.scenes import Scene, SceneOptions, load_scene
from training.scenes.scene_options import checked_box, require_rays

FORMAT = 1


@dataclass(frozen=True)
class RunDescription:
    """What config.json says: how the run was asked for."""

    config: TrainConfig
    scene: Path
    options: SceneOptions
    provenance: dict[str, Any]
    depths: dict[str, Any] = field(default_factory=dict)  # near, far and aabb of a scene whose files do not tell them


@dataclass
class Run:
    path: Path
    description: RunDescription
    scene: Scene
    dataset: RayDataset
    method: Method
    state: Any  # what `method` made of `step` steps
    step: int

    @property
    def config(self) -> TrainConfig:
        return self.description.config

    @property
    def options(self) -> SceneOptions:
        return self.description.options

    @property
    def checkpoints(self) -> Path:
        return self.path / "checkpoints"


def start_run(path: Path, scene_path: Path, config: TrainConfig, options: SceneOptions) -> Run:
    """A new run, its method initialised, its config.json written. UserError where `path` holds something already."""
    with together():
        # a killed process may have left hidden files before it had begun a run
        if is_writer() and path.exists() and not (path.is_dir() and all(is_leftover(p.name) for p in path.iterdir())):
            remedy = "continue it with --resume, or choose another --out" if is_run(path) else "choose another --out"
            raise UserError("exists already", where=path, remedy=remedy)
    description = RunDescription(settled(config), scene_path.resolve(), options, _provenance())
    run = _assemble(path, description, scene_path)
    with together():
        write_description(path, run.description)
    return run


def load_run(path: str | Path, *, scene_path: str | Path | None = None) -> Run:
    """The run as its newest readable checkpoint left it. scene_path: where the photographs are now, if they moved.

    UserError where the folder is no run, has no readable checkpoint, or its scene is gone.
    """
    path = Path(path)
    description = read_description(path)
    if scene_path is None and not os.path.exists(description.scene):  # Path.exists raises where a name is too long
        remedy = "put them back, or say where they are now: snerg-bake, -eval and -report take --scene FOLDER"
        raise UserError("the photographs of this run are gone: no such folder", where=path, found=str(description.scene),
                        remedy=remedy)  # fmt: skip
    return _assemble(path, description, Path(scene_path or description.scene), _newest_checkpoint(path))


def resume_run(path: Path, description: RunDescription, scene_path: Path, config: TrainConfig) -> Run:
    """The run at `path` to go on with; one that was stopped before its first checkpoint starts over.

    config: its own, but for settings that may change, such as more steps. Stores it, and where the photographs are now.
    """
    with together():
        _require_own_files(path)
    description = replace(description, config=config, scene=scene_path.resolve())
    checkpoint = _newest_checkpoint(path) if list_checkpoints(path / "checkpoints") else None
    run = _assemble(path, description, scene_path, checkpoint)
    with together():
        write_description(path, description)
    return run


def _require_own_files(path: Path) -> None:
    """UserError for a link or a pipe in the run: writing would change another file of the user's, or wait for a reader."""
    for folder in (path, path / "validation", path / "checkpoints"):
        for file in folder.iterdir() if folder.is_dir() else ():
            if not file.is_dir() and (file.is_symlink() or not file.is_file()):
                raise UserError("is no file of the run but a link, a pipe or a device", where=file,
                                remedy="put a copy of the file in its place, or remove it")  # fmt: skip


def _assemble(
    path: Path, description: RunDescription, scene_path: Path, checkpoint: tuple[int, dict[str, np.ndarray]] | None = None
) -> Run:  # fmt: skip
    """Photographs -> Scene -> RayDataset -> Method -> state: that of a checkpoint, or the one before step 0."""
    config = description.config
    with progress("reading photographs", 1.0, quiet=not is_writer()) as bar:
        with together():
            scene = load_scene(scene_path, description.options)
            if checkpoint is None:
                require_rays(scene)
        scene, description = _with_depths(scene, description, checkpoint is None)
        dataset = make_dataset(scene, folder=path, contracted=config.method == "multires")
        with together():
            method = make_method(config, dataset)
        bar.update(1.0)
    if checkpoint is None:
        state, step = method.start(jax.random.PRNGKey(config.seed)), 0
    else:
        step, arrays = checkpoint
        try:
            state = method.restore(arrays)
        except KeyError as missing:
            raise UserError("the run was trained by another version of snerg", where=path,
                            expected=f"{missing.args[0]!r} in its checkpoint",
                            remedy="train it again into another folder") from missing  # fmt: skip
    return Run(path, description, scene, dataset, method, state, step)


def _with_depths(scene: Scene, description: RunDescription, begins: bool) -> tuple[Scene, RunDescription]:
    """The scene with the depths of the run, which a run that begins finds where the files do not tell them (process 0 does)."""
    if begins and scene.guessed and not description.depths:
        with together():
            found = with_depths(scene) if is_writer() else scene
        near, far, *box = map(float, agree(np.array([found.near, found.far, *found.aabb.ravel()])))
        description = replace(description, depths={"near": near, "far": far, "aabb": box})
    if description.depths:
        scene = replace(scene, **{**description.depths, "aabb": np.array(description.depths["aabb"]).reshape(2, 3)})
    return scene, description


def make_method(config: TrainConfig, dataset: RayDataset) -> Method:
    """The method that config names, for the rays of a dataset; its modules are imported only when asked for."""
    if config.method == "nerf":
        if config.exposure == "on":
            remedy = "use --preset quick, normal or full"
            raise UserError("is fitted by the method multires only", where="--exposure on", remedy=remedy)
        from training.nerf.method import NerfMethod

        return NerfMethod(config, dataset)
    from training.multires.method import MultiresMethod

    return MultiresMethod(config, dataset)


def settled(config: TrainConfig) -> TrainConfig:
    """The config of a run that begins here, with what this machine decides: a run keeps its engine wherever it goes on."""
    if config.method == "nerf":
        return replace(config, engine="jax")
    from training.multires.method import chosen_engine

    return replace(config, engine=chosen_engine(config.engine))


def _newest_checkpoint(path: Path) -> tuple[int, dict[str, np.ndarray]]:
    """(step, arrays) of a run's newest readable checkpoint. UserError where there is none, or processes see others."""
    with together():
        step, arrays = read_newest_checkpoint(path / "checkpoints")
    first_step = int(agree(np.array(step)))
    with together():
        if step != first_step:
            raise UserError("the processes of this run see different checkpoints", where=path, expected=f"step {first_step}",
                            found=f"step {step}", remedy="use a folder that all hosts share")  # fmt: skip
    return step, arrays


def require_bakeable(run: Run) -> None:
    """UserError where no pack can hold the run's model, whose colour depends on the view at every sample, not once a pixel."""
    view = run.config.nerf.view
    if run.config.method == "nerf" and view not in ("deferred", "none"):
        raise UserError(
            "this run cannot be baked: its colour depends on the viewing direction at every sample", where=run.path,
            expected="a deferred or diffuse model", found=f"--nerf.view {view}",
            remedy="train with another preset (normal, paper, diffuse); snerg-eval scores this run as it is",
        )  # fmt: skip


def is_run(path: Path) -> bool:
    """Whether a folder looks like a run."""
    return (path / "config.json").is_file()


def write_description(path: Path, description: RunDescription) -> None:
    """Writes config.json, atomically (process 0 does)."""
    if not is_writer():
        return
    document = {
        "format": FORMAT, "scene": str(description.scene), "scene_options": vars(description.options),
        "config": asdict(description.config), "provenance": description.provenance, "depths": description.depths,
    }  # fmt: skip
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        write_file(path / "config.json", json.dumps(document, indent=2) + "\n")


def read_description(path: Path) -> RunDescription:
    """Reads config.json. UserError where the folder is missing, no run, or of another version."""
    file = path / "config.json"
    if not path.is_dir():
        raise UserError("no such run", where=path, remedy="train one first: snerg-train SCENE --out RUN")
    if not file.is_file():
        raise UserError("not a run", where=path, expected="a folder with config.json, from snerg-train")
    try:
        document = read_json_file(file)
        if document["format"] != FORMAT:
            raise UserError("made by another version of snerg", where=file, expected=FORMAT, found=document["format"])
        os.fsencode(document["scene"])  # ValueError where it could be no path
        config = from_json(TrainConfig, document["config"], str(file))
        options = SceneOptions(**document["scene_options"])
        require_valid(replace(options, aabb=None, up=None), str(file))  # whose numbers may be negative
        depths = dict(document.get("depths", {}))
        if depths:
            depths = {"near": float(depths["near"]), "far": float(depths["far"]), "aabb": checked_box(depths["aabb"])}
            if not 0 <= depths["near"] < depths["far"] < math.inf:
                raise ValueError(f"depths from {depths['near']} to {depths['far']}")
        return RunDescription(config, Path(document["scene"]), options, dict(document.get("provenance", {})), depths)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError("the run's description is damaged", where=file, found=str(error)[:100]) from error


def _provenance() -> dict[str, Any]:
    try:
        version = metadata.version("snerg")
    except metadata.PackageNotFoundError:
        version = "unknown"
    return {
        "snerg": version, "jax": jax.__version__, "device": f"{jax.device_count()} x {jax.devices()[0].device_kind}",
        "processes": jax.process_count(), "host": platform.platform(),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }  # fmt: skip
