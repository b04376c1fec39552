"""LLFF scenes: poses_bounds.npy and images[_K]; forward-facing ones in NDC, 360 degree captures spherified.

A row of poses_bounds.npy holds 17 numbers: a 3 x 5 matrix, row-major, of the camera-to-world axes down, right, back, position,
and (height, width, focal length) of the full-size pictures; then nearest and farthest depth. Rows are sorted by pictures' names.
"""

from pathlib import Path

import numpy as np

from console import UserError
from training.scenes.files import find_masks, notice, visible_files
from training.scenes.photographs import photographs_of
from training.scenes.pixels import may_be_transparent
from training.scenes.poses import faces_forward, pose
from training.scenes.scene import HELD_OUT_BY_NAME, Camera, Scene, hold_out
from training.scenes.scene_options import SceneOptions
from training.scenes.space import frame_forward, frame_of_sphere, space_forward, space_of_bounds

LOOKED_FOR = "poses_bounds.npy with images or images_K (LLFF)"
MOST_BYTES = 64 << 20  # of poses_bounds.npy; a row takes 136


def recognises(path: Path) -> bool:
    return (path / "poses_bounds.npy").is_file()


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads poses, chooses the folder of pictures that suits the downscale, checks their headers."""
    P, (height, width), focal, bounds = read_poses_bounds(path / "poses_bounds.npy")
    folders = picture_folders(path)
    factor = choose_factor(path, list(folders), options.downscale)
    sources = visible_files(folders[factor])
    if len(sources) != len(P):
        expected = f"{len(P)} pictures"
        raise UserError("pictures and poses disagree", where=folders[factor], expected=expected, found=len(sources))
    masks = masks_of(path, factor, [source.name for source in sources]) if options.masks else [None] * len(sources)
    spherified = options.spherify
    if spherified is None and not faces_forward(P):
        notice(path, "the cameras look all around; reading it with --spherify")
        spherified = True
    frame = frame_of_sphere(P) if spherified else frame_forward(P, bounds.min())
    cameras = [Camera(matrix, width, height, focal, focal, width / 2, height / 2) for matrix in frame.poses(P)]
    described = zip([source.stem for source in sources], sources, cameras, masks, strict=True)
    photographs = photographs_of(path, described, factor, options.downscale)
    if spherified:
        space = space_of_bounds(photographs, bounds * frame.scale, opaque=not may_be_transparent(photographs))
    else:
        space = space_forward(photographs)
    return Scene(**vars(space), path=path, kind="llff", splits=hold_out(photographs), held_out=HELD_OUT_BY_NAME)


def read_poses_bounds(path: Path) -> tuple[np.ndarray, tuple[int, int], float, np.ndarray]:
    """world_T_camera [N, 4, 4] (OpenGL axes), (height, width) and focal length of full pictures, depths [N, 2]."""
    try:  # mapped, not read: a header may claim any size, and an archive is no file of numbers
        stored = np.lib.format.open_memmap(path, mode="r")
    except Exception as error:  # NumPy does not say which its reader raises
        raise UserError("not a NumPy file of numbers", where=path, found=str(error).split("\n")[0][:80]) from error
    is_table = stored.shape[1:] == (17,) and stored.dtype.kind in "fiu"
    if not is_table or not 0 < stored.nbytes <= MOST_BYTES:
        found = f"{stored.dtype} {list(stored.shape)}"[:80]
        raise UserError("not an LLFF pose file", where=path, expected="[N, 17]", found=found)
    rows = np.array(stored, np.float64)
    down, right, back, position, hwf = np.moveaxis(rows[:, :15].reshape(-1, 3, 5), -1, 0)
    bounds = rows[:, 15:]
    sound = (np.rint(hwf[:, :2]) >= 1) & (hwf[:, 2:] > 0) & (bounds[:, :1] > 0) & (bounds[:, 1:] > bounds[:, :1])
    if not sound.all() or np.isinf(np.hstack([hwf, bounds])).any():
        raise UserError("sizes or depths are not finite, not positive or not near before far", where=path)
    if np.ptp(hwf, axis=0).max() > 1e-6 * hwf.max():
        raise UserError("the poses name different cameras", where=path, expected="one size and focal length")
    height, width, focal = hwf[0]
    matrices = np.stack([right, -down, back, position], axis=-1)
    P = np.stack([pose(matrix, f"{path} row {row}") for row, matrix in enumerate(matrices)])
    return P, (round(height), round(width)), float(focal), bounds


def picture_folders(path: Path) -> dict[int, Path]:
    """The folders images_K by K (1 for images), at least one. UserError where there is none."""
    folders = {1: path / "images"} if (path / "images").is_dir() else {}
    for folder in path.glob("images_*"):
        suffix = folder.name.removeprefix("images_")
        if folder.is_dir() and suffix.isascii() and suffix.isdigit() and int(suffix) > 0:
            folders[int(suffix)] = folder
    if not folders:
        raise UserError("no pictures", where=path, expected="a folder images or images_K")
    return folders


def choose_factor(path: Path, usable: list[int], downscale: int) -> int:
    """The largest K of `usable` folders images_K up to the downscale; a Notice where all are smaller pictures than asked for."""
    if fitting := [factor for factor in usable if factor <= downscale]:
        return max(fitting)
    name = "images" if min(usable) == 1 else f"images_{min(usable)}"
    notice(path, f"no pictures as large as --downscale {downscale} asks for; using {name}")
    return min(usable)


def masks_folder(path: Path, factor: int) -> Path:
    """Where the masks of the pictures in images_K are."""
    return path / ("masks" if factor == 1 else f"masks_{factor}")


def masks_of(path: Path, factor: int, names: list[str]) -> list[Path | None]:
    """The masks of pictures by their names within images_K. UserError where one has none."""
    folder = masks_folder(path, factor)
    if not folder.is_dir():
        raise UserError("no masks", where=folder, expected="a folder of masks", remedy="leave out --masks")
    masks = find_masks(folder, names)
    if None in masks:
        without = names[masks.index(None)]
        raise UserError("a picture without a mask", where=folder, expected=without, remedy="leave out --masks")
    return masks
