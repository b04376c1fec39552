"""A run on disk, and how to get it back: config.json, checkpoints/, metrics.jsonl, validation/.

config.json holds the TrainConfig, the scene's folder and how it is read (to read the same photographs again)
and provenance. Photographs -> (load_scene) Scene -> (make_dataset) RayDataset -> (make_method) Method ->
state, from the newest checkpoint.
"""

from __future__ import annotations

import json
import platform
import time
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import numpy as np

from console import UserError
from console.atomic import write_file
from training.checkpoints import cannot_write, list_checkpoints, read_newest_checkpoint
from training.config import TrainConfig, from_json, to_json
from training.dataset import RayDataset, make_dataset
from training.devices import agree, is_writer, together
from training.method import Method
from training.methods import make_method, settled
from training.scenes import Scene, SceneOptions, load_scene
from training.scenes.box import checked_box

FORMAT = 1


@dataclass
class Run:
    """A training run in memory. `state` is what `method` made of `step` steps; see training.method."""

    path: Path
    config: TrainConfig
    scene: Scene
    options: SceneOptions
    dataset: RayDataset
    method: Method
    state: Any
    step: int

    @property
    def downscale(self) -> int:
        """What the photographs were shrunk by."""
        return self.options.downscale

    @property
    def checkpoints(self) -> Path:
        """Folder of the checkpoints."""
        return self.path / "checkpoints"


@dataclass(frozen=True)
class RunDescription:
    """What config.json says: how the run was asked for."""

    config: TrainConfig
    scene: Path
    options: SceneOptions
    provenance: dict[str, Any]

    @property
    def downscale(self) -> int:
        """What the photographs were shrunk by."""
        return self.options.downscale


def start_run(path: Path, scene_path: Path, config: TrainConfig, options: SceneOptions) -> Run:
    """Reads the scene, initialises the method and writes config.json. UserError where `path` holds
    something already.
    """
    with together():
        if is_writer() and path.exists() and (not path.is_dir() or any(path.iterdir())):
            remedy = "continue it with --resume, or choose another --out" if is_run(path) else "choose another --out"
            raise UserError("exists already", where=path, remedy=remedy)
        scene = load_scene(scene_path, **vars(options))
    dataset = make_dataset(scene)
    config = settled(config)
    with together():
        method = make_method(config, scene, dataset)
    state = method.start(jax.random.PRNGKey(config.seed))
    with together():
        write_description(path, RunDescription(config, scene_path.resolve(), options, _provenance()))
    return Run(path, config, scene, options, dataset, method, state, step=0)


def load_run(path: str | Path, *, scene_path: str | Path | None = None, config: TrainConfig | None = None) -> Run:
    """The run as its newest readable checkpoint left it (a damaged one is passed over with a warning line).

    scene_path: where the photographs are now, if they moved. config: replaces the stored one (more steps,
    say). UserError where the folder is no run, has no readable checkpoint, or its scene is gone.
    """
    path = Path(path)
    description = read_description(path)
    config = config or description.config
    with together():
        step, arrays = read_newest_checkpoint(path / "checkpoints")
        scene = load_scene(scene_path or description.scene, **vars(description.options))
    first_step = int(agree(np.array(step)))
    with together():
        if step != first_step:
            raise UserError(
                "the processes of this run see different checkpoints",
                where=path,
                expected=f"step {first_step}",
                found=f"step {step}",
                remedy="use a folder that all hosts share",
            )
    dataset = make_dataset(scene)
    with together():
        method = make_method(config, scene, dataset)
    return Run(path, config, scene, description.options, dataset, method, _restored(method, arrays, path), step)


def _restored(method: Method, arrays: dict[str, np.ndarray], path: Path) -> Any:
    """The method's state. UserError where the checkpoint lacks what this version of the method keeps."""
    try:
        return method.restore(arrays)
    except KeyError as missing:
        raise UserError(
            "the run was trained by another version of snerg",
            where=path,
            expected=f"{missing.args[0]!r} in its checkpoint",
            remedy="train it again into another folder",
        ) from missing


def resume_run(path: Path, scene_path: Path, config: TrainConfig) -> Run:
    """load_run for going on with it: a run that was stopped before its first checkpoint starts over."""
    description = read_description(path)
    if list_checkpoints(path / "checkpoints"):
        run = load_run(path, scene_path=scene_path, config=config)
    else:
        with together():
            scene = load_scene(scene_path, **vars(description.options))
        dataset = make_dataset(scene)
        method = make_method(config, scene, dataset)
        state = method.start(jax.random.PRNGKey(config.seed))
        run = Run(path, config, scene, description.options, dataset, method, state, step=0)
    write_description(
        path,
        RunDescription(config, Path(scene_path).resolve(), description.options, description.provenance),
    )
    return run


def require_bakeable(run: Run) -> None:
    """UserError where the run's model is none that a pack can hold: colour decided at every sample, not once a pixel."""
    view = run.config.nerf.view
    if run.config.method == "nerf" and view not in ("deferred", "none"):
        raise UserError(
            "this run cannot be baked: its colour depends on the viewing direction at every sample",
            where=run.path,
            expected="a deferred or diffuse model",
            found=f"--nerf.view {view}",
            remedy="train with another preset (cpu, fast, paper, diffuse); snerg-eval scores this run as it is",
        )


def is_run(path: Path) -> bool:
    """Whether a folder looks like a run."""
    return (path / "config.json").is_file()


def write_description(path: Path, description: RunDescription) -> None:
    """Writes config.json, atomically (process 0 does)."""
    if not is_writer():
        return
    document = {
        "format": FORMAT,
        "scene": str(description.scene),
        "scene_options": vars(description.options),
        "config": to_json(description.config),
        "provenance": description.provenance,
    }
    try:
        path.mkdir(parents=True, exist_ok=True)
        write_file(path / "config.json", json.dumps(document, indent=2) + "\n")
    except OSError as error:
        raise cannot_write(path, error) from error


def read_description(path: Path) -> RunDescription:
    """Reads config.json. UserError where the folder is missing, no run, or of another version."""
    file = path / "config.json"
    if not path.is_dir():
        raise UserError("no such run", where=path, remedy="train one first: snerg-train SCENE --out RUN")
    if not file.is_file():
        raise UserError("not a run", where=path, expected="a folder with config.json, from snerg-train")
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if document["format"] != FORMAT:
            raise UserError("made by another version of snerg", where=file, expected=FORMAT, found=document["format"])
        config = from_json(TrainConfig, document["config"], str(file))
        return RunDescription(
            config,
            Path(document["scene"]),
            _scene_options(document["scene_options"]),
            dict(document.get("provenance", {})),
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError("the run's description is damaged", where=file, found=str(error)[:100]) from error


def _scene_options(values: dict[str, Any]) -> SceneOptions:
    """Options from JSON, which knows no tuples; those that an older run lacks have their defaults."""
    box = values.get("aabb")
    return SceneOptions(**{**values, "aabb": None if box is None else checked_box(box)})


def _provenance() -> dict[str, Any]:
    try:
        version = metadata.version("snerg")
    except metadata.PackageNotFoundError:
        version = "unknown"
    return {
        "snerg": version,
        "jax": jax.__version__,
        "device": f"{jax.device_count()} x {jax.devices()[0].device_kind}",
        "processes": jax.process_count(),
        "host": platform.platform(),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
