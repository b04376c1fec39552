"""COLMAP scenes: sparse/N with cameras, images and points3D, and the pictures in images or images_K.

COLMAP chooses frame and unit by itself. A forward-facing capture is put where LLFF's are (depths come from the points
that each image shows), any other where those of transforms.json are. Near, far and box come from the points, without
the outliers; see training.scenes.space. Every 8th picture, by name, is held out.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

from console import Notice, UserError
from training.scenes.colmap_files import Reconstruction, model_suffix, read_reconstruction
from training.scenes.files import FileFinder, clean_name, few, is_hidden
from training.scenes.llff import choose_factor, masks_folder, masks_of, picture_folders, target_size
from training.scenes.picture_cameras import camera_of_picture, tell_turned
from training.scenes.picture_formats import PICTURE_SUFFIXES
from training.scenes.pictures import PictureLoader, picture_size
from training.scenes.pixels import may_be_transparent
from training.scenes.poses import faces_forward
from training.scenes.scene import HELD_OUT_BY_NAME, Photograph, Scene, SceneOptions, hold_out
from training.scenes.space import (
    Frame,
    PointCloud,
    Space,
    depth_ranges,
    frame_about_focus,
    frame_forward,
    poses_of,
    space_forward,
    space_of_capture,
)
from training.scenes.upright import OPTION, axes_of

LOOKED_FOR = "sparse/0/cameras.bin with images (COLMAP)"


def recognises(path: Path) -> bool:
    """Whether the folder looks like a COLMAP scene."""
    return bool(_model_folders(path))


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the reconstruction, finds each image's picture and checks its header."""
    found = reconstruction_of(path)
    folder, factor = _choose_folder(path, found.names, options)
    listed = FileFinder(folder).find_all(found.names)
    _tell_left_out(path, folder, found, listed)
    found = found.only([index for index, picture in enumerate(listed) if picture is not None])
    pictures = [picture for picture in listed if picture is not None]
    names = [clean_name(name) for name in found.names]
    masks = masks_of(path, factor, names) if options.masks else [None] * len(names)
    photographs = []
    for name, camera, picture, mask in zip(names, found.cameras, pictures, masks, strict=True):
        camera, stored, as_stored = camera_of_picture(picture, lambda _, camera=camera: camera)
        size = target_size(stored, factor, options.downscale)
        photographs.append(
            Photograph(name, camera.resized(*size), PictureLoader(picture, stored, size, mask, as_stored))
        )
    tell_turned(path, photographs)
    photographs, space = _placed(path, found, photographs, options)
    return Scene(path=path, kind="colmap", splits=hold_out(photographs), held_out=HELD_OUT_BY_NAME, notes=vars(options),
                 **space._asdict())  # fmt: skip


def reconstruction_of(path: Path) -> Reconstruction:
    """The largest of the reconstructions that COLMAP wrote into a scene's folder. UserError where all are damaged."""
    folders = _model_folders(path)
    if len(folders) == 1:
        return read_reconstruction(folders[0])
    read, errors = {}, []
    for folder in folders:
        try:
            read[folder] = read_reconstruction(folder)
        except UserError as error:
            errors.append(error)
    if not read:
        raise errors[0]
    best = max(read, key=lambda folder: len(read[folder].names))
    parts = ", ".join(f"{folder.name}: {len(read[folder].names)}" for folder in read)
    text = f"COLMAP split the capture into {len(folders)} parts; reading {best.name}, the largest (images: {parts})"
    warnings.warn(Notice(f"{path / 'sparse'}: {text}"), stacklevel=3)
    return read[best]


def _model_folders(path: Path) -> list[Path]:
    """Where reconstructions lie: in folders of sparse, else in sparse itself."""
    sparse = path / "sparse"
    folders = sorted(folder for folder in sparse.glob("*") if model_suffix(folder)) if sparse.is_dir() else []
    return folders or [folder for folder in (sparse,) if model_suffix(folder)]


# --- pictures ---------------------------------------------------------------------------------------------------------


def _choose_folder(path: Path, names: tuple[str, ...], options: SceneOptions) -> tuple[Path, int]:
    """The folder of pictures images_K with the largest K up to the downscale, and K (1 for images).

    A folder that lacks most pictures, is of another size than it says, or (where wanted) has no masks, is passed over.
    """
    folders = picture_folders(path)
    if options.masks and not any(masks_folder(path, factor).is_dir() for factor in folders):
        raise UserError("no masks", where=masks_folder(path, min(folders)), expected="a folder of masks",
                        remedy="leave out --masks")  # fmt: skip
    if list(folders) == [1]:
        return folders[1], 1
    found = {factor: FileFinder(folder).find_all(names) for factor, folder in folders.items()}
    sizes = {
        factor: next((picture_size(p) for p in pictures if p is not None), None) for factor, pictures in found.items()
    }
    usable = [
        factor
        for factor in sorted(folders)
        if factor == 1
        or (_fits(sizes[factor], sizes.get(1), factor) and sum(map(bool, found[factor])) > len(names) / 2)
    ]
    if options.masks:
        usable = [factor for factor in usable if masks_folder(path, factor).is_dir()] or usable
    factor = choose_factor(path, usable or [min(folders)], options.downscale)
    return folders[factor], factor


def _fits(size: tuple[int, int] | None, full: tuple[int, int] | None, factor: int) -> bool:
    """Whether pictures are `factor` times smaller than full ones, to a pixel of theirs."""
    if size is None or full is None:
        return size is not None
    return all(abs(small - large / factor) <= 1.0 for small, large in zip(size, full, strict=True))


def _tell_left_out(path: Path, folder: Path, found: Reconstruction, listed: list[Path | None]) -> None:
    """UserError where no picture is there; a Notice of pictures that are gone, and of those that have no pose."""
    gone = [name for name, picture in zip(found.names, listed, strict=True) if picture is None]
    if len(gone) == len(listed):
        raise UserError(
            "picture not found", where=folder / gone[0], remedy="no image of the reconstruction has its picture"
        )
    if gone:
        text = f"{len(gone)} of {len(listed)} images of the reconstruction have no picture and are left out"
        warnings.warn(Notice(f"{folder}: {text} ({few(gone)})"), stacklevel=3)
    known = {picture for picture in listed if picture is not None}
    stored = (p for p in folder.rglob("*") if p.suffix.lower() in PICTURE_SUFFIXES and p not in known)
    unposed = sorted(p.relative_to(folder).as_posix() for p in stored if not is_hidden(p))
    if unposed:
        total = len(known) + len(unposed)
        text = f"{len(unposed)} of {total} pictures have no pose in the reconstruction and are left out"
        warnings.warn(Notice(f"{folder}: {text} ({few(unposed)})"), stacklevel=3)


# --- frame and space --------------------------------------------------------------------------------------------------


def _placed(
    path: Path, found: Reconstruction, photographs: list[Photograph], options: SceneOptions
) -> tuple[list[Photograph], Space]:
    """The photographs in the training frame, and what a Scene says of the space."""
    P, points = found.world_T_camera, PointCloud(found.points, found.tracks, found.seen)
    if points.suffices and not options.spherify and faces_forward(P):
        if options.up is not None:
            raise UserError("what is up cannot be told of a forward-facing scene", where=OPTION, found=str(path),
                            remedy="leave it out, or use --spherify")  # fmt: skip
        placed = _moved(photographs, frame_forward(P, depth_ranges(P, points).min()))
        try:
            space = space_forward([one.camera for one in placed], [one.name for one in placed])
            text = "the cameras look forward; --spherify reads it as seen from all around"
            warnings.warn(Notice(f"{path}: {text}"), stacklevel=3)
            return placed, space
        except UserError as error:  # wide lenses, cameras that walk ahead
            text = f"the cameras look forward, but {error.found} sees too far aside for NDC"
            warnings.warn(Notice(f"{path}: {text}; reading it as seen from all around"), stacklevel=3)
    frame = frame_about_focus(P)
    if options.up is not None:
        frame = frame.turned(axes_of(options.up))
    placed = _moved(photographs, frame)
    if not points.suffices:
        text = f"{len(found.points)} points say too little of where things are; the box is a guess, which --aabb mends"
        warnings.warn(Notice(f"{path}: {text}"), stacklevel=3)
    opaque = not options.masks and not may_be_transparent(placed)
    cameras = [photograph.camera for photograph in placed]
    return placed, space_of_capture(cameras, points.moved(frame) if points.suffices else None, opaque=opaque)


def _moved(photographs: list[Photograph], frame: Frame) -> list[Photograph]:
    """The photographs in the training frame."""
    P = frame.poses(poses_of([photograph.camera for photograph in photographs]))
    pairs = zip(photographs, P, strict=True)
    return [replace(one, camera=replace(one.camera, world_T_camera=world_T_camera)) for one, world_T_camera in pairs]
