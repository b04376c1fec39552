"""COLMAP's pipeline on prepared pictures: features (SIFT), matches, and an incremental reconstruction. Runs in the child process.

All that is finished is in the database, so whoever is killed goes on from there; the reconstruction itself starts over. One
seed, and one thread where the order of a sum would decide, make it the same each time; but pycolmap's matcher, on several
threads, rarely loses matches (docs/results.md), and one thread would take as many times as long as there are cores.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from training.posing.pairs import ALL_UP_TO, LARGEST, all_pairs, chosen_pairs
from training.posing.stillness import pairs_that_stand_still, stands_still

DATABASE, PAIRS, MODELS, MODEL = "database.db", "pairs.txt", "models", "model"
LENS = "SIMPLE_RADIAL"  # while pictures are being added; the parameters of richer ones need many pictures
LONGEST_SIDE = 1600  # pixels in which features are looked for; places are those of the full picture
UNKNOWN_FOCAL = 1.2  # of the longer side
AT_ONCE = 60  # pairs between two reports
FEWEST_INLIERS = 15  # COLMAP's own for a pair that matches
FEWEST_FOR_LENS = 10  # pictures of one camera whose second distortion coefficient and principal point are fitted
FARTHEST_CENTRE = 0.08  # of the picture's side, from its middle

Tell = Callable[[str, float, float], None]  # what goes on, units done, units in all


@dataclass(frozen=True)
class Group:
    """Pictures of one camera. names: in the folder of images. focal: in pixels, None where it is not known."""

    names: tuple[str, ...]
    focal: float | None


@dataclass(frozen=True)
class Task:
    """images: the folder of prepared pictures. work: what is found is kept there. names: of all pictures, in order.

    masks: a folder of masks NAME.png. masked: the pictures that have one: features are found where it is not black.
    """

    images: Path
    work: Path
    names: tuple[str, ...]
    groups: tuple[Group, ...]
    seed: int = 0
    masks: Path = Path()
    masked: frozenset[str] = frozenset()

    @property
    def database(self) -> Path:
        return self.work / DATABASE


@dataclass(frozen=True)
class Found:
    """registered: names of the pictures that have a pose in the largest model. features, matched: by name, how many features
    a picture has and with how many others it matches. models: the pictures of each model, the largest first. points,
    error: of the largest model: their number, and their mean distance in pixels from where they should be seen. still: of
    how many pairs the camera stands still, and of how many pairs that match; where it is most, poses are not looked for.
    """

    registered: list[str] = field(default_factory=list)
    features: dict[str, int] = field(default_factory=dict)
    matched: dict[str, int] = field(default_factory=dict)
    models: list[list[str]] = field(default_factory=list)
    still: tuple[int, int] = (0, 0)
    points: int = 0
    error: float = 0.0


def reconstruct(task: Task, tell: Tell) -> Found:
    """Features, matches, poses; the largest model, its lens fitted, is left in `task.work` / MODEL."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)  # what goes wrong shows in what is found
    _begin_database(task)
    _extract(task, tell)
    _match(task, tell)
    features, matched, still = _table(task)
    models = [] if stands_still(*still) else _map(task, tell)
    if not models:
        return Found(features=features, matched=matched, still=still)
    best = _with_fitted_lens(models[0])
    folder = task.work / MODEL
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    best.write_binary(folder)
    named = [sorted(model.image(number).name for number in model.reg_image_ids()) for model in (best, *models[1:])]
    error = best.compute_mean_reprojection_error()
    return Found(named[0], features, matched, named, still, best.num_points3D(), error)


def measured(images: Path, names: Sequence[str]) -> tuple[float, float]:
    """Seconds that the features and the matches of some pictures of one camera take. Nothing of them is kept."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    with tempfile.TemporaryDirectory(prefix="snerg-measured-") as folder:
        task = Task(images, Path(folder), tuple(names), (Group(tuple(names), None),))
        _begin_database(task)
        started = time.monotonic()
        _extract(task, lambda *_: None)
        between = time.monotonic()
        _match(task, lambda *_: None)
        return between - started, time.monotonic() - between


# --- features ---------------------------------------------------------------------------------------------------------


def _begin_database(task: Task) -> None:
    """All cameras and pictures, numbered in their order, so that no thread's speed decides; begun anew where it is broken."""
    if task.database.exists():
        database = pycolmap.Database.open(task.database)
        whole = database.num_images() == len(task.names) and all(
            database.exists_keypoints(image.image_id) == database.exists_descriptors(image.image_id)
            for image in database.read_all_images()
        )
        database.close()
    else:
        whole = False
    if not whole:
        for leftover in task.work.glob(f"{DATABASE}*"):
            leftover.unlink()
        pycolmap.Database.open(task.database).close()
        for group in task.groups:
            pycolmap.import_images(task.database, task.images, pycolmap.CameraMode.SINGLE, group.names, _reading())
    database = pycolmap.Database.open(task.database)
    camera_of = {image.name: image.camera_id for image in database.read_all_images()}
    for group in task.groups:
        camera = database.read_camera(camera_of[group.names[0]])
        camera.focal_length = group.focal or UNKNOWN_FOCAL * max(camera.width, camera.height)
        camera.has_prior_focal_length = group.focal is not None
        database.update_camera(camera)
    database.close()


def _reading(**more: Any) -> Any:
    return pycolmap.ImageReaderOptions(camera_model=LENS, default_focal_length_factor=UNKNOWN_FOCAL, **more)


def _extract(task: Task, tell: Tell) -> None:
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, max_image_size=LONGEST_SIDE, num_threads=_threads())
    database = pycolmap.Database.open(task.database)
    there = {image.name for image in database.read_all_images() if database.exists_keypoints(image.image_id)}
    database.close()
    for masked in (False, True):
        todo = [name for name in task.names if name not in there and (name in task.masked) == masked]
        reading = _reading(mask_path=task.masks) if masked else _reading()
        for names in _batches(todo, max(_threads(), 2)):
            tell("features", len(there), len(task.names))
            pycolmap.extract_features(
                task.database, task.images, names, reader_options=reading, extraction_options=options,
                device=pycolmap.Device.cpu,
            )  # fmt: skip
            there |= set(names)
    tell("features", len(task.names), len(task.names))


# --- matches ----------------------------------------------------------------------------------------------------------


def _match(task: Task, tell: Tell) -> None:
    database = pycolmap.Database.open(task.database)
    number_of = {image.name: image.image_id for image in database.read_all_images()}
    numbers = [number_of[name] for name in task.names]
    pairs = all_pairs(len(numbers)) if len(numbers) <= ALL_UP_TO else chosen_pairs(_largest_features(database, numbers))
    todo = [(i, j) for i, j in pairs if not database.exists_two_view_geometry(numbers[i], numbers[j])]
    database.close()
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=_threads())
    verifying = pycolmap.TwoViewGeometryOptions()
    verifying.ransac.random_seed = task.seed
    done = len(pairs) - len(todo)
    for batch in _batches(todo, AT_ONCE):
        tell("matches", done, len(pairs))
        lines = [f"{task.names[i]} {task.names[j]}\n" for i, j in batch]
        (task.work / PAIRS).write_text("".join(lines), encoding="utf-8")
        pycolmap.match_image_pairs(
            task.database, matching, pycolmap.ImportedPairingOptions(match_list_path=task.work / PAIRS), verifying,
            device=pycolmap.Device.cpu,
        )  # fmt: skip
        done += len(batch)
    tell("matches", len(pairs), len(pairs))


def _largest_features(database: Any, numbers: Sequence[int]) -> list[np.ndarray]:
    """Descriptors of each picture's features of the largest scale. A keypoint is x, y and an affine shape [2, 2]."""
    found = []
    for number in numbers:
        keypoints, descriptors = database.read_keypoints(number), database.read_descriptors(number).data
        scales = np.abs(np.linalg.det(keypoints[:, 2:6].reshape(-1, 2, 2))) if len(keypoints) else np.zeros(0)
        found.append(descriptors[np.argsort(-scales, kind="stable")[:LARGEST]])
    return found


def _table(task: Task) -> tuple[dict[str, int], dict[str, int], tuple[int, int]]:
    """By name, how many features a picture has, and with how many others it matches; and Found.still."""
    database = pycolmap.Database.open(task.database)
    names = {image.image_id: image.name for image in database.read_all_images()}
    features = {name: database.num_keypoints_for_image(number) for number, name in names.items()}
    matched = dict.fromkeys(names.values(), 0)
    for pair, inliers in zip(*database.read_two_view_geometry_num_inliers(), strict=True):
        if inliers >= FEWEST_INLIERS:
            for number in pycolmap.pair_id_to_image_pair(pair):
                matched[names[number]] += 1
    still = pairs_that_stand_still(database, FEWEST_INLIERS)
    database.close()
    return features, matched, still


# --- poses ------------------------------------------------------------------------------------------------------------


def _map(task: Task, tell: Tell) -> list[Any]:
    """Models, the largest first."""
    folder = task.work / MODELS
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    options = pycolmap.IncrementalPipelineOptions(min_model_size=3, max_num_models=10)
    options.num_threads = options.mapper.num_threads = 1  # with four, one in three reconstructions came out otherwise
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = task.seed
    total, added = len(task.names), 0

    def next_image() -> None:
        nonlocal added
        added += 1
        tell("poses", min(added, total), total)

    tell("poses", 0, total)
    pycolmap.set_random_seed(task.seed)  # here, whatever this process did before
    models = pycolmap.incremental_mapping(
        task.database, task.images, folder, options, next_image_callback=next_image
    ).values()
    return sorted(models, key=lambda model: (model.num_reg_images(), model.num_points3D()), reverse=True)


def _with_fitted_lens(model: Any) -> Any:
    """The model with a second distortion coefficient and the principal point fitted, for cameras of enough pictures.

    Phones crop for stabilisation, which moves the principal point. Where the fit runs away, the model stays as it is.
    """
    pictures: dict[int, int] = {}
    for number in model.reg_image_ids():
        camera = model.image(number).camera_id
        pictures[camera] = pictures.get(camera, 0) + 1
    if min(pictures.values()) < FEWEST_FOR_LENS:
        return model
    fitted = pycolmap.Reconstruction(model)
    for camera in fitted.cameras.values():
        focal, cx, cy, k = camera.params
        camera.model = pycolmap.CameraModelId.RADIAL
        camera.params = [focal, cx, cy, k, 0.0]
    options = pycolmap.BundleAdjustmentOptions(refine_principal_point=True, print_summary=False)
    options.ceres.solver_options.num_threads = 1
    pycolmap.bundle_adjustment(fitted, options)
    fitted.update_point_3d_errors()
    off = [
        max(abs(camera.principal_point_x / camera.width - 0.5), abs(camera.principal_point_y / camera.height - 0.5))
        for number, camera in fitted.cameras.items()
        if number in pictures
    ]
    better = fitted.compute_mean_reprojection_error() <= model.compute_mean_reprojection_error()
    return fitted if better and max(off) < FARTHEST_CENTRE else model


def _batches(items: Sequence[Any], size: int) -> list[Sequence[Any]]:
    return [items[i : i + size] for i in range(0, len(items), size)]


def _threads() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
