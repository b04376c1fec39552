"""LLFF scenes: poses_bounds.npy and images[_K]; forward-facing ones in NDC, 360 degree captures spherified.

A row of poses_bounds.npy holds 17 numbers: a 3 x 5 matrix, row-major, of the camera-to-world axes down, right, back,
its position, and (height, width, focal length) of the full-size pictures; then the nearest and farthest depth that
it sees.

Forward-facing (NeRF appendix C): positions shrink by 1 / (0.75 nearest depth), so that the NDC near plane of 1 lies
before everything; the mean pose becomes the origin. 360 degrees: the point that all cameras look at becomes the
origin, the mean direction to the cameras z, their root mean square distance 1; samples are spread in disparity.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from console import Notice, UserError
from scenepack.constants import NDC_NEAR
from training.scenes.blender import WORLDSPACE_T_OPENGL
from training.scenes.pictures import PictureLoader, picture_size
from training.scenes.poses import faces_forward, focus_point, mean_pose, normalised, poses, similarity
from training.scenes.rays import camera_rays, ndc_rays
from training.scenes.scene import Camera, Photograph, Scene, SceneOptions, hold_out

LOOKED_FOR = "poses_bounds.npy with images or images_K (LLFF)"
BOUNDS_FACTOR = 0.75
NEAR_360, FAR_360 = 0.45, 100.0  # at most, and at least: in units of the cameras' distance
HALF_SIDE_360 = 1.2  # of the box that holds the content, likewise: at most
NDC_WORLDSPACE_T_OPENGL = np.diag([1.0, 1.0, -1.0, 1.0])  # docs/format.md, "Coordinate frames"
MOST_BYTES = 64 << 20  # of poses_bounds.npy; a row takes 136
PICTURES = (".png", ".jpg", ".jpeg")


def recognises(path: Path) -> bool:
    """Whether the folder looks like an LLFF scene."""
    return (path / "poses_bounds.npy").is_file()


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads poses, chooses the folder of pictures that suits the downscale, checks their headers."""
    P, full_size, focal, bounds = read_poses_bounds(path / "poses_bounds.npy")
    sources, factor = choose_pictures(path, options.downscale)
    if len(sources) != len(P):
        raise UserError(
            "pictures and poses disagree", where=sources[0].parent, expected=f"{len(P)} pictures", found=len(sources)
        )
    masks = mask_paths(path, sources, factor) if options.masks else [None] * len(sources)
    spherified = options.spherify
    if spherified is None and not faces_forward(P):
        warnings.warn(Notice(f"{path}: the cameras look all around; reading it with --spherify"), stacklevel=2)
        spherified = True
    P, bounds = spherify(P, bounds) if spherified else recentre(P, bounds)
    photographs = []
    for pose, source, mask in zip(P, sources, masks, strict=True):
        stored = picture_size(source)
        _check_aspect(source, stored, full_size)
        target = target_size(stored, factor, options.downscale)
        height, width = full_size
        camera = Camera(pose, width, height, focal, focal, width / 2, height / 2).resized(*target)
        photographs.append(Photograph(source.stem, camera, PictureLoader(source, stored, target, mask)))
    splits = hold_out(photographs)
    facts = _facts_360(photographs, bounds) if spherified else ndc_facts(photographs)
    return Scene(path=path, kind="llff", splits=splits, notes=vars(options), **facts)


def read_poses_bounds(path: Path) -> tuple[np.ndarray, tuple[int, int], float, np.ndarray]:
    """world_T_camera [N, 4, 4] (OpenGL axes), (height, width) and focal length of full pictures, depths [N, 2]."""
    rows = _rows(path)
    if not np.isfinite(rows).all():
        raise UserError(
            "a pose or depth is not finite", where=path, found=f"row {int(np.argwhere(~np.isfinite(rows))[0, 0])}"
        )
    matrices = rows[:, :15].reshape(-1, 3, 5)
    down, right, back, position, hwf = np.moveaxis(matrices, -1, 0)
    bounds = rows[:, 15:]
    if (
        (np.rint(hwf[:, :2]) < 1).any()
        or (hwf <= 0).any()
        or (bounds[:, 0] <= 0).any()
        or (bounds[:, 1] <= bounds[:, 0]).any()
    ):
        raise UserError("sizes and depths must be positive, near before far", where=path)
    if np.ptp(hwf, axis=0).max() > 1e-6 * hwf.max():
        raise UserError("the poses name different cameras", where=path, expected="one size and focal length")
    height, width, focal = hwf[0]
    P = poses(np.stack([right, -down, back, position], axis=-1), f"{path} row")
    return P, (round(height), round(width)), float(focal), bounds


def _rows(path: Path) -> np.ndarray:
    """float64 [N, 17]. NumPy's own reader opens archives, too, believes a header's size, and ends in any exception."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            if size > MOST_BYTES or file.read(1) == b"":
                raise ValueError(f"{size} bytes")
            file.seek(0)
            version = np.lib.format.read_magic(file)
            if version[0] > 2:
                raise ValueError(f"version {version[0]} of its format")
            read = np.lib.format.read_array_header_1_0 if version[0] == 1 else np.lib.format.read_array_header_2_0
            shape, by_columns, dtype = read(file)
            data = file.read()
    except Exception as error:  # whatever NumPy's reading of a header comes to
        raise UserError("not a NumPy file of numbers", where=path, found=str(error).split("\n")[0][:80]) from error
    if len(shape) != 2 or shape[1] != 17 or shape[0] < 1 or dtype.kind not in "fiu":
        raise UserError("not an LLFF pose file", where=path, expected="[N, 17]", found=f"{dtype} {list(shape)}"[:80])
    if len(data) != shape[0] * shape[1] * dtype.itemsize:
        needed = shape[0] * shape[1] * dtype.itemsize
        raise UserError("is damaged", where=path, expected=f"{needed} bytes of numbers", found=len(data))
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C").astype(np.float64)


def picture_folders(path: Path) -> dict[int, Path]:
    """The folders images_K by K (1 for images), at least one. UserError where there is none."""
    folders = {1: path / "images"} if (path / "images").is_dir() else {}
    for folder in path.glob("images_*"):
        suffix = folder.name.removeprefix("images_")
        if folder.is_dir() and suffix.isdigit() and int(suffix) > 0:
            folders[int(suffix)] = folder
    if not folders:
        raise UserError("no pictures", where=path, expected="a folder images or images_K")
    return folders


def choose_pictures(path: Path, downscale: int) -> tuple[list[Path], int]:
    """The pictures of images_K with the largest K up to the downscale, sorted, and K (1 for images)."""
    folders = picture_folders(path)
    fitting = [factor for factor in folders if factor <= downscale]
    factor = max(fitting) if fitting else min(folders)
    if not fitting:
        warnings.warn(
            Notice(f"{path}: no pictures as large as --downscale {downscale} asks for; using {folders[factor].name}"),
            stacklevel=3,
        )
    pictures = sorted(p for p in folders[factor].iterdir() if p.suffix.lower() in PICTURES)
    if not pictures:
        raise UserError("no pictures", where=folders[factor], expected="PNG or JPEG")
    return pictures, factor


def mask_paths(path: Path, sources: list[Path], factor: int) -> list[Path | None]:
    """The masks of pictures: the same names (or NAME_mask) in masks or masks_K beside the folder of pictures."""
    folder = path / ("masks" if factor == 1 else f"masks_{factor}")
    if not folder.is_dir():
        raise UserError("no masks", where=folder, expected="a folder of masks", remedy="leave out --masks")
    by_stem = {p.stem.removesuffix("_mask"): p for p in folder.iterdir() if p.suffix.lower() in PICTURES}
    for source in sources:
        if source.stem not in by_stem:
            raise UserError("a picture without a mask", where=folder, expected=source.stem)
    return [by_stem[source.stem] for source in sources]


def recentre(P: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses and depths of a forward-facing scene in the frame that the NDC warp starts from."""
    if np.linalg.norm(P[:, :3, 2].mean(0)) < 1e-3:
        raise _not_forward("the cameras look into opposite directions")
    scale = 1.0 / (BOUNDS_FACTOR * bounds.min())
    mean = mean_pose(P)
    return similarity(mean[:3, :3], mean[:3, 3], scale, P), bounds * scale


def spherify(P: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses and depths of a 360 degree capture about the point it looks at, cameras at root mean square distance 1."""
    try:
        centre = focus_point(P)
    except np.linalg.LinAlgError as error:
        raise UserError("all cameras look the same way, so they have no common centre", where="poses_bounds.npy",
                        remedy="leave out --spherify") from error  # fmt: skip
    distance = np.sqrt(np.square(P[:, :3, 3] - centre).sum(-1).mean())
    if distance < 1e-9:
        raise UserError("all cameras stand at the point that they look at", where="poses_bounds.npy",
                        remedy="check the poses")  # fmt: skip
    z = normalised((P[:, :3, 3] - centre).mean(0))
    x = normalised(np.cross([0.1, 0.2, 0.3], z))  # any direction across; this one is NeRF's
    axes = np.stack([x, np.cross(z, x), z], axis=1)
    scale = 1.0 / distance
    return similarity(axes, centre, scale, P), bounds * scale


def _facts_360(photographs: list[Photograph], bounds: np.ndarray) -> dict:
    cameras = [photograph.camera for photograph in photographs]
    # what the widest camera frames around the origin, corners included
    framed = max(
        np.linalg.norm(c.world_T_camera[:3, 3]) * np.hypot(c.width / c.fx, c.height / c.fy) / 2 for c in cameras
    )
    half = min(HALF_SIDE_360, float(framed))
    near = float(np.clip(0.9 * bounds.min(), 0.05, NEAR_360))
    return {
        "near": near,
        "far": max(FAR_360, float(bounds.max())),
        "disparity": True,
        "aabb": np.array([[-half] * 3, [half] * 3]),
        "worldspace_T_opengl": WORLDSPACE_T_OPENGL,
    }


def ndc_facts(photographs: list[Photograph]) -> dict:
    """What a Scene in NDC says of the space. UserError where a photograph sees what the warp cannot show."""
    camera = photographs[0].camera
    ndc_camera = (camera.width, camera.height, camera.fx)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for photograph in photographs:  # the corners of all views bound what any of them sees
        x = np.array([0.0, 1.0, 0.0, 1.0]) * camera.width
        y = np.array([0.0, 0.0, 1.0, 1.0]) * camera.height
        origins, directions = camera_rays(photograph.camera, x, y)
        if (directions[:, 2] > -1e-3).any() or (origins[:, 2] < -NDC_NEAR).any():
            raise _not_forward(photograph.name)
        origins, directions = ndc_rays(origins, directions, *ndc_camera)
        ends = np.concatenate([origins, origins + directions])
        low, high = np.minimum(low, ends.min(0)), np.maximum(high, ends.max(0))
    return {
        "near": 0.0,
        "far": 1.0,
        "ndc": True,
        "ndc_camera": ndc_camera,
        "aabb": np.stack([low, high]),
        "worldspace_T_opengl": NDC_WORLDSPACE_T_OPENGL,
    }


def _not_forward(found: str) -> UserError:
    return UserError("not a forward-facing capture", where="poses_bounds.npy", found=found, remedy="use --spherify")


def target_size(stored: tuple[int, int], factor: int, downscale: int) -> tuple[int, int]:
    """Size of the pictures to train on, from stored ones that are `factor` times smaller than full size."""
    scale = min(1.0, factor / downscale)
    size = int(stored[0] * scale + 1e-6), int(stored[1] * scale + 1e-6)
    if min(size) < 1:
        raise UserError("downscale leaves no picture", where=f"--downscale {downscale}", remedy="use a smaller factor")
    return size


def _check_aspect(source: Path, stored: tuple[int, int], full_size: tuple[int, int]) -> None:
    height, width = full_size
    if abs(stored[0] / stored[1] - width / height) > 0.02 * width / height:
        raise UserError(
            "the picture is of another size",
            where=source,
            expected=f"the shape of {width}x{height}",
            found=f"{stored[0]}x{stored[1]}",
        )
