"""COLMAP's pipeline on prepared pictures: features (SIFT), matches, and an incremental reconstruction. Runs in the child process.

What is finished is in the database, from which a killed process goes on; the reconstruction itself starts over. One seed, and one
thread where the order of a sum matters, give the same poses each time, but for pycolmap's matcher, which rarely loses matches.

Of few pictures all pairs are matched; of many, neighbours in their order and pictures whose features of the largest scale match
("preemptive matching", Wu, Towards Linear-time Incremental Structure from Motion, 3DV 2013). That also finds where a walk around
something comes back to its beginning. Notation: N pictures, F features of each, descriptors uint8 [F, 128].
"""

import os
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

DATABASE, PAIRS, MODELS, MODEL = "database.db", "pairs.txt", "models", "model"
LENS = pycolmap.CameraModelId.SIMPLE_RADIAL  # while pictures are being added; richer ones need many pictures
PANORAMA = pycolmap.CameraModelId.EQUIRECTANGULAR
PANORAMA_FINER = 2  # times the pixels in which features are looked for: they show several times the angle
LONGEST_SIDE = 1600  # pixels in which features are looked for; places are those of the full picture
MOST_FEATURES = 8192
UNKNOWN_FOCAL = 1.2  # of the longer side
AT_ONCE = 60  # pairs between two reports
ALL_UP_TO = 60  # pictures of which all pairs are matched
OVERLAP = 8  # next pictures that each is matched with; and those 16, 32, … further on
MOST_ALIKE = 12  # others
LARGEST = 200  # features that are compared, of the largest scale
RATIO = 0.85  # of the distances to the nearest and the second nearest feature, at most
TOGETHER = 50  # pictures that one is compared with at once: 8 MB
FEWEST_ALIKE = 4  # such matches; fewer are chance
FEWEST_INLIERS = 15  # COLMAP's own for a pair that matches
FEWEST_FOR_LENS = 10  # pictures of one camera, for more than a focal length and one distortion coefficient to be fitted
SQUEEZED = 0.03  # pixels whose width and height differ more are not square; lenses make a hundredth
MUCH_BETTER = 0.85  # of the reprojection error with square pixels: what is left with others, at most
FARTHEST_CENTRE = 0.08  # of the picture's side, from its middle
STILL = 0.003  # of the picture's longer side: matches that move less on average stand still
MOST_STILL = 0.5  # of the pairs that match; a walk has neighbours that hardly differ, but not so many
PLACES = 60  # of matching features of a pair that are compared in brightness
GEOMETRY = pycolmap.TwoViewGeometryConfiguration

OnProgress = Callable[[str, float, float], object]  # what goes on, units done, units in all


@dataclass(frozen=True)
class Task:
    images: Path  # the folder of prepared pictures
    work: Path  # what is found is kept there
    names: Sequence[str]  # of all pictures, in order
    groups: Sequence[tuple[Sequence[str], float | None, bool]]  # see prepare.CameraGroup
    seed: int = 0
    masks: Path = Path()  # a folder of masks NAME.png
    masked: Sequence[str] = ()  # the pictures that have one: features are found where it is not black
    longest_side: int = LONGEST_SIDE
    most_features: int = MOST_FEATURES  # of a picture

    @property
    def database(self) -> Path:
        return self.work / DATABASE


def _features_and_matches(task: Task, on_progress: OnProgress) -> None:
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)  # what goes wrong shows in what is found
    _begin_database(task)
    _extract(task, on_progress)
    _match(task, on_progress)


def reconstruct(task: Task, on_progress: OnProgress) -> dict[str, Any]:
    """Features, matches, poses; the largest model, its lens fitted, is left in `task.work` / MODEL. What is found:

    matched: by name, how many others a picture matches
    still: of how many pairs the camera stands still, and of how many that match
    is_static: the camera stands still; poses are not looked for
    registered, models: pictures that have a pose in the largest model, and in each, the largest first
    points, error: of the largest model, and their mean distance in pixels from where they should be seen
    """
    _features_and_matches(task, on_progress)
    found = {**_matches_found(task), "registered": [], "models": [], "points": 0, "error": 0.0}
    models = [] if found["is_static"] else _map(task, on_progress)
    if not models:
        return found
    squeezed = _with_two_focals(models[0])
    if squeezed is not None:
        models = _map_again(task, squeezed, on_progress) or [squeezed, *models[1:]]
    best = _with_fitted_lens(models[0])
    folder = task.work / MODEL
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    best.write_binary(folder)
    named = [sorted(model.image(number).name for number in model.reg_image_ids()) for model in (best, *models[1:])]
    error = best.compute_mean_reprojection_error()
    return {**found, "registered": named[0], "models": named, "points": best.num_points3D(), "error": error}


def matching_pairs(task: Task, on_progress: OnProgress) -> dict[str, Any]:
    """is_static: whether the camera stands still before what turns. pairs: which pictures match; of each pair:

    first, second: the names
    share: of the features of the one that has fewer, that match as one scene does that stands still
    moving: share of the matches that do not
    turned: whether the camera turned and did not move, or all lies in one plane
    places: [K, 4], x, y in the first and x, y in the second picture of some features, as shares of width and height
    """
    _features_and_matches(task, on_progress)
    found = []
    with pycolmap.Database.open(task.database) as database:
        sizes = {camera.camera_id: (camera.width, camera.height) for camera in database.read_all_cameras()}
        for both, config, places in _verified_pairs(database):
            inliers, (first, second) = len(places[0]), (image.name for image in both)
            matches = len(database.read_matches(*(image.image_id for image in both)))
            features = min(database.num_keypoints_for_image(image.image_id) for image in both)
            some = [at[:: max(inliers // PLACES, 1)] for at in places]
            shares = [at / sizes[image.camera_id] for image, at in zip(both, some, strict=True)]
            found.append({
                "first": first, "second": second,
                "share": inliers / max(features, 1), "moving": 1 - inliers / max(matches, 1),
                "turned": config in (GEOMETRY.PANORAMIC, GEOMETRY.PLANAR_OR_PANORAMIC),
                "places": np.concatenate(shares, 1).round(4).tolist(),
            })  # fmt: skip
    return {"pairs": found, "is_static": _matches_found(task)["is_static"]}


def measured(images: Path, names: Sequence[str]) -> tuple[float, float]:
    """Seconds that the features and the matches of some pictures of one camera take. Nothing of them is kept."""
    began: dict[str, float] = {}
    with tempfile.TemporaryDirectory(prefix="snerg-measured-") as folder:
        task = Task(images, Path(folder), names, [(names, None, False)])
        _features_and_matches(task, lambda title, *_: began.setdefault(title, time.monotonic()))
        return began["matches"] - began["features"], time.monotonic() - began["matches"]


# --- features ---------------------------------------------------------------------------------------------------------


def _begin_database(task: Task) -> None:
    """All cameras and pictures, numbered in their order whatever the threads' speed; begun anew where it is broken."""
    whole = False
    if task.database.exists():
        with pycolmap.Database.open(task.database) as database:
            numbers = [image.image_id for image in database.read_all_images()]
            paired = [database.exists_keypoints(number) == database.exists_descriptors(number) for number in numbers]
            whole = len(numbers) == len(task.names) and all(paired)
    if not whole:
        for leftover in task.work.glob(f"{DATABASE}*"):
            leftover.unlink()
        pycolmap.Database.open(task.database).close()
        for names, *_ in task.groups:
            pycolmap.import_images(task.database, task.images, pycolmap.CameraMode.SINGLE, names, _reading())
    with pycolmap.Database.open(task.database) as database:
        camera_of = {image.name: image.camera_id for image in database.read_all_images()}
        for names, focal, is_panorama in task.groups:
            camera = database.read_camera(camera_of[names[0]])
            camera.model = PANORAMA if is_panorama else LENS  # where a process was killed, it may be another
            guess = focal or UNKNOWN_FOCAL * max(camera.width, camera.height)
            size = camera.width, camera.height
            camera.params = size if is_panorama else [guess, size[0] / 2, size[1] / 2, 0.0]
            camera.has_prior_focal_length = focal is not None and not is_panorama
            database.update_camera(camera)


def _reading(**more: Any) -> Any:
    return pycolmap.ImageReaderOptions(camera_model=LENS.name, default_focal_length_factor=UNKNOWN_FOCAL, **more)


def _extract(task: Task, on_progress: OnProgress) -> None:
    side = task.longest_side * (PANORAMA_FINER if any(is_panorama for *_, is_panorama in task.groups) else 1)
    options = pycolmap.FeatureExtractionOptions(use_gpu=False, max_image_size=side, num_threads=_threads())
    options.sift.max_num_features = task.most_features
    with pycolmap.Database.open(task.database) as database:
        there = {image.name for image in database.read_all_images() if database.exists_keypoints(image.image_id)}
    for masked in (False, True):
        todo = [name for name in task.names if name not in there and (name in task.masked) == masked]
        reading = _reading(mask_path=task.masks) if masked else _reading()
        for names in _batches(todo, max(_threads(), 2)):
            on_progress("features", len(there), len(task.names))
            pycolmap.extract_features(
                task.database, task.images, names, reader_options=reading, extraction_options=options,
                device=pycolmap.Device.cpu,
            )  # fmt: skip
            there |= set(names)
    on_progress("features", len(task.names), len(task.names))


# --- matches ----------------------------------------------------------------------------------------------------------


def _match(task: Task, on_progress: OnProgress) -> None:
    with pycolmap.Database.open(task.database) as database:
        number_of = {image.name: image.image_id for image in database.read_all_images()}
        numbers = [number_of[name] for name in task.names]
        pairs = list(combinations(range(len(numbers)), 2))
        if len(numbers) > ALL_UP_TO:
            pairs = chosen_pairs(_largest_features(database, numbers))
        todo = [(i, j) for i, j in pairs if not database.exists_two_view_geometry(numbers[i], numbers[j])]
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=_threads())
    verifying = pycolmap.TwoViewGeometryOptions()
    verifying.ransac.random_seed = task.seed
    done = len(pairs) - len(todo)
    for batch in _batches(todo, AT_ONCE):
        on_progress("matches", done, len(pairs))
        lines = [f"{task.names[i]} {task.names[j]}\n" for i, j in batch]
        (task.work / PAIRS).write_text("".join(lines), encoding="utf-8")
        pycolmap.match_image_pairs(
            task.database, matching, pycolmap.ImportedPairingOptions(match_list_path=task.work / PAIRS), verifying,
            device=pycolmap.Device.cpu,
        )  # fmt: skip
        done += len(batch)
    on_progress("matches", len(pairs), len(pairs))


def _largest_features(database: Any, numbers: Sequence[int]) -> list[np.ndarray]:
    """Descriptors of each picture's features of the largest scale. A keypoint is x, y and an affine shape [2, 2]."""
    found = []
    for number in numbers:
        keypoints, descriptors = database.read_keypoints(number), database.read_descriptors(number).data
        scales = np.abs(np.linalg.det(keypoints[:, 2:6].reshape(-1, 2, 2))) if len(keypoints) else np.zeros(0)
        found.append(descriptors[np.argsort(-scales, kind="stable")[:LARGEST]])
    return found


def how_many_pairs(count: int) -> int:
    """How many pairs of `count` pictures are matched, at most."""
    return count * (count - 1) // 2 if count <= ALL_UP_TO else count * (len(_steps(count)) + MOST_ALIKE)


def _steps(count: int) -> list[int]:
    """How much further on in the order the pictures are that each is matched with."""
    return [*range(1, OVERLAP + 1), *(1 << k for k in range(count.bit_length()) if 1 << k > OVERLAP)]


def chosen_pairs(descriptors: Sequence[np.ndarray]) -> list[tuple[int, int]]:
    """Sorted pairs (i, j), i < j, of pictures with these features of the largest scale: [F, 128] each."""
    count = len(descriptors)
    pairs = {(i, i + step) for i in range(count) for step in _steps(count) if i + step < count}
    alike = likeness(descriptors)
    for i in range(count):
        best = np.argsort(-alike[i], kind="stable")[:MOST_ALIKE]
        pairs |= {(min(i, j), max(i, j)) for j in map(int, best) if alike[i, j] >= FEWEST_ALIKE}
    return sorted(pairs)


def likeness(descriptors: Sequence[np.ndarray]) -> np.ndarray:
    """How many features [N, N] of one picture have their match in another. Symmetric, 0 on the diagonal."""
    count = len(descriptors)
    unit = np.zeros((count, LARGEST, 128), np.float32)  # rows of zeros where a picture has fewer: they match nothing
    for row, found in zip(unit, descriptors, strict=True):
        row[: len(found[:LARGEST])] = found[:LARGEST]
    unit /= np.maximum(np.linalg.norm(unit, axis=-1, keepdims=True), 1e-6)
    alike = np.zeros((count, count), np.int64)
    for i in range(count):
        for first in range(i + 1, count, TOGETHER):
            others = slice(first, min(first + TOGETHER, count))
            alike[i, others] = alike[others, i] = _matches(unit[i], unit[others])
    return alike


def _matches(a: np.ndarray, others: np.ndarray) -> np.ndarray:
    """For each of some pictures [M, F, 128] the features that are its and `a`'s nearest, and much nearer than the second: [M]."""
    cosine = np.einsum("fd,mgd->mfg", a, others, optimize=True)
    nearest, back = cosine.argmax(axis=2), cosine.argmax(axis=1)
    first = np.take_along_axis(cosine, nearest[..., None], axis=2)[..., 0]
    np.put_along_axis(cosine, nearest[..., None], -1.0, axis=2)
    clear = (2.0 - 2.0 * first) < RATIO**2 * (2.0 - 2.0 * cosine.max(axis=2))
    return (clear & (np.take_along_axis(back, nearest, axis=1) == np.arange(len(a)))).sum(axis=1)


def _verified_pairs(database: Any) -> Iterator[tuple[list[Any], Any, list[np.ndarray]]]:
    """The two images of each pair that matches, how one follows from the other (GEOMETRY), and where both show the features that
    match, [M, 2] in pixels."""
    images = {image.image_id: image for image in database.read_all_images()}
    places: dict[int, np.ndarray] = {}
    for pair, inliers in zip(*database.read_two_view_geometry_num_inliers(), strict=True):
        if inliers >= FEWEST_INLIERS:
            both = pycolmap.pair_id_to_image_pair(pair)
            for number in {*both} - {*places}:
                places[number] = np.asarray(database.read_keypoints(number))[:, :2]
            geometry = database.read_two_view_geometry(*both)
            rows = np.asarray(geometry.inlier_matches)
            matching = [places[number][rows[:, k]] for k, number in enumerate(both)]
            yield [images[number] for number in both], geometry.config, matching


def _matches_found(task: Task) -> dict[str, Any]:
    """What is known before poses are looked for: see reconstruct.

    Before a turntable, camera and background stand still: features of the background match at the same place of the picture, and
    outvote what turns.
    """
    with pycolmap.Database.open(task.database) as database:
        sides = {camera.camera_id: max(camera.width, camera.height) for camera in database.read_all_cameras()}
        matched = {image.name: 0 for image in database.read_all_images()}
        still = pairs = 0
        for both, _, (first, second) in _verified_pairs(database):
            for image in both:
                matched[image.name] += 1
            longest = max(sides[image.camera_id] for image in both)
            still += bool(np.median(np.linalg.norm(first - second, axis=-1)) < STILL * longest)
            pairs += 1
    return {"matched": matched, "still": (still, pairs), "is_static": still > MOST_STILL * pairs}


# --- poses ------------------------------------------------------------------------------------------------------------


def _map(task: Task, on_progress: OnProgress, title: str = "poses") -> list[Any]:
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
        on_progress(title, min(added, total), total)

    on_progress(title, 0, total)
    pycolmap.set_random_seed(task.seed)  # here, whatever this process did before
    found = pycolmap.incremental_mapping(task.database, task.images, folder, options, next_image_callback=next_image)
    return sorted(found.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()), reverse=True)


def _with_two_focals(model: Any) -> Any:
    """The model with two focal lengths for cameras whose pixels are clearly not square; None where none has such.

    Pictures that were squeezed to a square, say: poses with one focal length are wrong by degrees.
    """
    pictures = _pictures_of_cameras(model)
    fitted = pycolmap.Reconstruction(model)
    lenses = {number: camera for number, camera in fitted.cameras.items() if camera.model == LENS}  # not of panoramas
    for number, camera in lenses.items():
        if pictures[number] >= FEWEST_FOR_LENS:
            focal, cx, cy, k = camera.params
            camera.model = pycolmap.CameraModelId.OPENCV
            camera.params = [focal, focal, cx, cy, k, 0.0, 0.0, 0.0]
    _adjust(fitted)
    ratios = [camera.focal_length_x / camera.focal_length_y for camera in lenses.values()]
    squeezed = any(abs(np.log(ratio)) > SQUEEZED for ratio in ratios)
    before, after = (_median_error(each) for each in (model, fitted))
    return fitted if squeezed and after < MUCH_BETTER * before else None


def _median_error(model: Any) -> float:
    """Median reprojection error of the points, in pixels. One diverged point would decide a mean: 1e150 pixels were seen."""
    model.update_point_3d_errors()
    return float(np.median([point.error for point in model.points3D.values()]))


def _map_again(task: Task, squeezed: Any, on_progress: OnProgress) -> list[Any]:
    """Models of cameras that begin as in `squeezed`; none where fewer pictures get a pose."""
    with pycolmap.Database.open(task.database) as database:
        for camera in squeezed.cameras.values():
            camera.has_prior_focal_length = True
            database.update_camera(camera)
    models = _map(task, on_progress, "poses of squeezed pictures")
    return models if models and models[0].num_reg_images() >= squeezed.num_reg_images() else []


def _with_fitted_lens(model: Any) -> Any:
    """The model with a second distortion coefficient and the principal point fitted, for cameras of enough pictures.

    Phones crop for stabilisation, which moves the principal point. Where the fit runs away, the model stays as it is.
    """
    pictures = _pictures_of_cameras(model)
    if min(pictures.values()) < FEWEST_FOR_LENS:
        return model
    fitted = pycolmap.Reconstruction(model)
    for camera in fitted.cameras.values():
        if camera.model == LENS:
            camera.model, camera.params = pycolmap.CameraModelId.RADIAL, [*camera.params, 0.0]
    _adjust(fitted, refine_principal_point=True)
    off = [
        max(abs(camera.principal_point_x / camera.width - 0.5), abs(camera.principal_point_y / camera.height - 0.5))
        for number, camera in fitted.cameras.items()
        if number in pictures and camera.model != PANORAMA
    ]
    better = fitted.compute_mean_reprojection_error() <= model.compute_mean_reprojection_error()
    return fitted if better and max(off, default=0.0) < FARTHEST_CENTRE else model


def _pictures_of_cameras(model: Any) -> Counter[int]:
    """How many pictures with a pose each camera has, by its number."""
    return Counter(model.image(number).camera_id for number in model.reg_image_ids())


def _adjust(model: Any, **refined: bool) -> None:
    """Adjusts poses, points and lenses to one another. refined: see pycolmap.BundleAdjustmentOptions."""
    options = pycolmap.BundleAdjustmentOptions(print_summary=False, **refined)
    options.ceres.solver_options.num_threads = 1
    pycolmap.bundle_adjustment(model, options)
    model.update_point_3d_errors()


def _batches(items: Sequence[Any], size: int) -> list[Sequence[Any]]:
    return [items[i : i + size] for i in range(0, len(items), size)]


def _threads() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
