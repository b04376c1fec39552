"""COLMAP scenes: sparse/0/{cameras,images,points3D}.bin or .txt (or sparse/ itself) and the pictures in images or images_K.

From all around: as in a transforms.json capture the point that the cameras look at becomes the origin, their mean up
direction z, their mean distance 1. Facing forward: NDC, as in an LLFF capture, from the depths of the points that each
image shows. In both, the points say how near and far things are and, from all around, which box holds them. A point
counts the more the more images show it, since what was matched once or twice may be a mistake. Every 8th picture, by
name, is held out.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from console import Notice, UserError
from training.scenes.blender import WORLDSPACE_T_OPENGL
from training.scenes.colmap_files import Reconstruction, model_suffix, read_reconstruction
from training.scenes.llff import NEAR_360, ndc_facts, picture_folders, recentre, target_size
from training.scenes.pictures import PictureLoader, find_mask, picture_size
from training.scenes.pixels import may_be_transparent
from training.scenes.poses import faces_forward, similarity
from training.scenes.scene import Camera, Photograph, Scene, SceneOptions, hold_out
from training.scenes.transforms import FAR, HALF_SIDE, NEAR, normalise
from training.scenes.upright import OPTION, axes_of

LOOKED_FOR = "sparse/0/cameras.bin with images (COLMAP)"
PICTURES = (".png", ".jpg", ".jpeg")
FEWEST_POINTS = 50  # fewer say little of where the content is
OUTLIERS = 0.01  # share of all observations left out at either end of the box, and of the distances
ROOM = 0.1  # added to each end of the box, as a share of its extent
# In units of the cameras' mean distance:
NEAREST, NEAREST_FAR = 0.02, 10.0  # near is at least, far at least
FARTHEST = 30.0  # reach of the box of a capture that looks outwards
LEAST_ROOM = 0.05
FRAMED, FEW_FRAMES = 0.95, 0.02  # how much of its points a picture's frame is put behind; share of the frames left out


def recognises(path: Path) -> bool:
    """Whether the folder looks like a COLMAP scene."""
    return _model_folder(path) is not None


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the reconstruction, finds each image's picture and checks its header."""
    found = reconstruction_of(path)
    folder, factor = _choose_folder(path, found.names, options)
    listed = [_find(folder, name) for name in found.names]
    _tell_left_out(path, folder, found, listed)
    found = found.only([index for index, picture in enumerate(listed) if picture is not None])
    pictures = [picture for picture in listed if picture is not None]
    photographs = []
    for name, of_colmap, picture in zip(found.names, found.cameras, pictures, strict=True):
        stored = picture_size(picture)
        size = target_size(stored, factor, options.downscale)
        mask = _mask(path, factor, name) if options.masks else None
        camera = _stored_camera(of_colmap, stored, picture).resized(*size)
        photographs.append(Photograph(Path(name).as_posix(), camera, PictureLoader(picture, stored, size, mask)))
    photographs, facts = _placed(path, found, photographs, options)
    return Scene(path=path, kind="colmap", splits=hold_out(photographs), notes=vars(options), **facts)


def reconstruction_of(path: Path) -> Reconstruction:
    """What COLMAP wrote into a scene's folder. UserError where it is damaged."""
    return read_reconstruction(_model_folder(path) or path)


def _model_folder(path: Path) -> Path | None:
    folders = (path / "sparse" / "0", path / "sparse")
    return next((folder for folder in folders if model_suffix(folder)), None)


# --- pictures ---------------------------------------------------------------------------------------------------------


def _choose_folder(path: Path, names: tuple[str, ...], options: SceneOptions) -> tuple[Path, int]:
    """The folder of pictures images_K with the largest K up to the downscale, and K (1 for images).

    A folder that lacks most pictures, is of another size than it says, or (where wanted) has no masks, is passed over.
    """
    folders = picture_folders(path)
    if options.masks and not any(_masks_folder(path, factor).is_dir() for factor in folders):
        raise UserError("no masks", where=_masks_folder(path, min(folders)), expected="a folder of masks",
                        remedy="leave out --masks")  # fmt: skip
    full = _first_size(folders[1], names) if 1 in folders else None
    usable = [
        factor
        for factor in sorted(folders)
        if factor == 1
        or (_fits(_first_size(folders[factor], names), full, factor) and _holds_most(folders[factor], names))
    ]
    if options.masks:
        usable = [factor for factor in usable if _masks_folder(path, factor).is_dir()] or usable
    fitting = [factor for factor in usable if factor <= options.downscale]
    factor = max(fitting) if fitting else min(usable, default=min(folders))
    if not fitting:
        text = f"no pictures as large as --downscale {options.downscale} asks for; using {folders[factor].name}"
        warnings.warn(Notice(f"{path}: {text}"), stacklevel=3)
    return folders[factor], factor


def _first_size(folder: Path, names: tuple[str, ...]) -> tuple[int, int] | None:
    picture = next((found for name in names if (found := _find(folder, name)) is not None), None)
    return None if picture is None else picture_size(picture)


def _fits(size: tuple[int, int] | None, full: tuple[int, int] | None, factor: int) -> bool:
    """Whether pictures are `factor` times smaller than full ones, to a pixel of theirs."""
    if size is None or full is None:
        return size is not None
    return all(abs(small - large / factor) <= 1.0 for small, large in zip(size, full, strict=True))


def _holds_most(folder: Path, names: tuple[str, ...]) -> bool:
    return sum(_find(folder, name) is not None for name in names) > len(names) / 2


def _find(folder: Path, name: str) -> Path | None:
    """The picture of that name in a folder, also where it was stored shrunk with another suffix."""
    exact = folder / name
    candidates = [exact, *(exact.with_suffix(suffix) for suffix in (*PICTURES, ".JPG", ".PNG"))]
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _masks_folder(path: Path, factor: int) -> Path:
    return path / ("masks" if factor == 1 else f"masks_{factor}")


def _mask(path: Path, factor: int, name: str) -> Path:
    """The mask of a picture. UserError where there is none."""
    folder = _masks_folder(path, factor)
    mask = find_mask(folder, name)
    if mask is None:
        raise UserError("a picture without a mask", where=folder, expected=name, remedy="leave out --masks")
    return mask


def _tell_left_out(path: Path, folder: Path, found: Reconstruction, listed: list[Path | None]) -> None:
    """UserError where no picture is there; a Notice of pictures that are gone, and of those that have no pose."""
    gone = [name for name, picture in zip(found.names, listed, strict=True) if picture is None]
    if len(gone) == len(listed):
        raise UserError(
            "picture not found", where=folder / gone[0], remedy="no image of the reconstruction has its picture"
        )
    if gone:
        text = f"{len(gone)} of {len(listed)} images of the reconstruction have no picture and are left out"
        warnings.warn(Notice(f"{folder}: {text} ({_few(gone)})"), stacklevel=3)
    known = {picture for picture in listed if picture is not None}
    stored = (p for p in folder.rglob("*") if p.suffix.lower() in PICTURES and p not in known)
    unposed = sorted(p.relative_to(folder).as_posix() for p in stored)
    if unposed:
        total = len(known) + len(unposed)
        text = f"{len(unposed)} of {total} pictures have no pose in the reconstruction and are left out"
        warnings.warn(Notice(f"{folder}: {text} ({_few(unposed)})"), stacklevel=3)
    others = [p.name for p in (path / "sparse").iterdir() if p.name != "0" and model_suffix(p)]
    if others and (path / "sparse" / "0").is_dir():
        text = f"COLMAP split the capture into {len(others) + 1} parts; reading 0, which has {len(listed)} images"
        warnings.warn(Notice(f"{path / 'sparse'}: {text}"), stacklevel=3)


def _few(names: list[str]) -> str:
    return ", ".join(names[:3]) + (", …" if len(names) > 3 else "")


def _stored_camera(camera: Camera, stored: tuple[int, int], picture: Path) -> Camera:
    """The camera for its stored picture, which may be smaller than the one that COLMAP saw."""
    if abs(stored[0] / stored[1] - camera.width / camera.height) > 0.02 * camera.width / camera.height:
        raise UserError(
            "the picture is of another size",
            where=picture,
            expected=f"the shape of {camera.width}x{camera.height}",
            found=f"{stored[0]}x{stored[1]}",
        )
    return camera.resized(*stored)


# --- frame and space --------------------------------------------------------------------------------------------------


def _placed(
    path: Path, found: Reconstruction, photographs: list[Photograph], options: SceneOptions
) -> tuple[list[Photograph], dict]:
    """The photographs in the training frame, and what a Scene says of the space."""
    enough = len(found.points) >= FEWEST_POINTS and sum(map(len, found.seen)) >= FEWEST_POINTS
    if enough and not options.spherify and faces_forward(found.world_T_camera):
        if options.up is not None:
            raise UserError("what is up cannot be told of a forward-facing scene", where=OPTION, found=str(path),
                            remedy="leave it out, or use --spherify")  # fmt: skip
        placed = _moved(photographs, recentre(found.world_T_camera, _depths(found))[0])
        try:
            facts = ndc_facts(placed)
            text = "the cameras look forward; --spherify reads it as seen from all around"
            warnings.warn(Notice(f"{path}: {text}"), stacklevel=3)
            return placed, facts
        except UserError as error:  # wide lenses, cameras that walk ahead
            text = f"the cameras look forward, but {error.found} sees too far aside for NDC"
            warnings.warn(Notice(f"{path}: {text}; reading it as seen from all around"), stacklevel=3)
    P, scale, centre, axes = normalise(found.world_T_camera)
    if options.up is not None:
        turn = axes_of(options.up)
        P, axes = similarity(turn, np.zeros(3), 1.0, P), axes @ turn
    near, far, box = NEAR, FAR, np.array([[-HALF_SIDE] * 3, [HALF_SIDE] * 3])
    if enough:
        points = scale * (found.points - centre) @ axes
        near, far = _near_far(P, points, found)
        box = box_of_points(points, found.tracks, HALF_SIDE if looks_inwards(P) else FARTHEST, otherwise=box)
        if not options.masks and not may_be_transparent(photographs):
            box = _with_frames(box, P, points, found, photographs)
    else:
        text = f"{len(found.points)} points say too little of where things are; the box is a guess, which --aabb mends"
        warnings.warn(Notice(f"{path}: {text}"), stacklevel=3)
    facts = {"near": near, "far": far, "aabb": box, "disparity": True, "worldspace_T_opengl": WORLDSPACE_T_OPENGL}
    return _moved(photographs, P), facts


def _moved(photographs: list[Photograph], P: np.ndarray) -> list[Photograph]:
    """The photographs with other poses [N, 4, 4]."""
    pairs = zip(photographs, P, strict=True)
    return [replace(one, camera=replace(one.camera, world_T_camera=world_T_camera)) for one, world_T_camera in pairs]


def _depths(found: Reconstruction) -> np.ndarray:
    """Nearest and farthest depth [N, 2] of what each image shows, in COLMAP's units; of all where it shows too little."""
    weights = [found.tracks[rows] for rows in found.seen]
    depths = [
        np.maximum(-(found.points[rows] - camera[:3, 3]) @ camera[:3, 2], 1e-6)
        for camera, rows in zip(found.world_T_camera, found.seen, strict=True)
    ]
    ends = (OUTLIERS, 1 - OUTLIERS)
    whole = _quantiles(np.concatenate(depths), np.concatenate(weights), ends)
    pairs = zip(depths, weights, strict=True)
    return np.array([_quantiles(d, w, ends) if len(d) >= FEWEST_POINTS else whole for d, w in pairs])


def _near_far(P: np.ndarray, points: np.ndarray, found: Reconstruction) -> tuple[float, float]:
    """Where rays begin and end: what images show lies between, with room to spare."""
    distances = [
        np.linalg.norm(points[rows] - camera[:3, 3], axis=-1) for camera, rows in zip(P, found.seen, strict=True)
    ]
    weights = np.concatenate([found.tracks[rows] for rows in found.seen])
    low, high = _quantiles(np.concatenate(distances), weights, (OUTLIERS, 1 - OUTLIERS))
    return float(np.clip(0.7 * low, NEAREST, NEAR_360)), float(max(2.0 * high, NEAREST_FAR))


def looks_inwards(P: np.ndarray) -> bool:
    """Whether most cameras [N, 4, 4] look at something between them, and not at walls around them; about the point looked at."""
    return bool(((P[:, :3, 2] * P[:, :3, 3]).sum(-1) > 0).mean() > 0.5)


def box_of_points(points: np.ndarray, tracks: np.ndarray, reach: float, otherwise: np.ndarray) -> np.ndarray:
    """The box [2, 3] of nearly all points, `reach` to either side at most; `otherwise` where there are too few."""
    counted = np.abs(points).max(-1) < FARTHEST
    if counted.sum() < FEWEST_POINTS:
        return otherwise
    ends = (OUTLIERS, 1 - OUTLIERS)
    low, high = np.stack([_quantiles(values, tracks[counted], ends) for values in points[counted].T], axis=1)
    room = np.maximum(ROOM * (high - low), LEAST_ROOM)
    box = np.clip(np.stack([low - room, high + room]), -reach, reach)
    return box if (box[1] > box[0]).all() else otherwise


def _with_frames(
    box: np.ndarray, P: np.ndarray, points: np.ndarray, found: Reconstruction, photographs: list[Photograph]
) -> np.ndarray:
    """The box [2, 3] grown to nearly all that opaque photographs show, up to their corners: points thin out towards these, and
    what is cut off is trained as specks before the lens."""
    frames = []
    for pose, photograph, rows in zip(P, photographs, found.seen, strict=True):
        if len(rows) < FEWEST_POINTS:
            continue
        depths = -(points[rows] - pose[:3, 3]) @ pose[:3, 2]
        _, depth = _quantiles(depths, found.tracks[rows], (0.0, FRAMED))
        lens = photograph.camera
        x, y = np.meshgrid([0.0, lens.width], [0.0, lens.height])
        corners = np.stack([(x - lens.cx) / lens.fx, -(y - lens.cy) / lens.fy, np.full_like(x, -1.0)], -1).reshape(4, 3)
        frames.append(pose[:3, 3] + depth * corners @ pose[:3, :3].T)
    if not frames:
        return box
    low, high = np.quantile(np.min(frames, 1), FEW_FRAMES, 0), np.quantile(np.max(frames, 1), 1 - FEW_FRAMES, 0)
    reach = max(HALF_SIDE, np.abs(box).max())  # as far as the points' box may reach, where cameras look inwards
    return np.stack([np.minimum(box[0], np.maximum(low, -reach)), np.maximum(box[1], np.minimum(high, reach))])


def _quantiles(values: np.ndarray, weights: np.ndarray, shares: tuple[float, float]) -> np.ndarray:
    """Quantiles [2] of weighted values [K]."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) / weights.sum()
    return values[order][np.minimum(np.searchsorted(reached, shares), len(values) - 1)]
