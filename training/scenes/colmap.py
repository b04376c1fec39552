"""COLMAP scenes: cameras, images and points3D in a folder of MODELS, and the pictures in images, in images_K or beside.

COLMAP chooses frame and unit by itself. A forward-facing capture is put where LLFF's are (depths come from the points that each
image shows), any other where those of transforms.json are. Near, far and box come from the points; see training.scenes.space.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from console import UserError
from training.scenes import space
from training.scenes.colmap_files import PARTS, Reconstruction, model_suffix, read_reconstruction
from training.scenes.files import PICTURE_SUFFIXES, FileFinder, clean_name, is_hidden, notice
from training.scenes.llff import choose_factor, masks_folder, masks_of, picture_folders
from training.scenes.photographs import moved, photographs_of
from training.scenes.picture_headers import read_header
from training.scenes.pixels import may_be_transparent
from training.scenes.poses import faces_forward
from training.scenes.scene import HELD_OUT_BY_NAME, Direction, Photograph, Scene, Space, hold_out
from training.scenes.scene_options import UP, SceneOptions, axes_of

LOOKED_FOR = "sparse/0/cameras.bin with images (COLMAP)"
# Where reconstructions lie: of COLMAP, of ns-process-data, and of programs that export to COLMAP.
MODELS = ("sparse/*", "sparse", "colmap/sparse/*", "colmap/sparse")
UNDISTORTED = ("dense", "dense/*")  # scenes of their own below that of the photographs, by image_undistorter


def recognises(path: Path) -> bool:
    return any(map(_model_folders, _scene_folders(path)))


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the reconstruction, finds each image's picture and checks its header."""
    found = reconstruction_of(path)
    beside = _scene_folder(path)
    folder, factor = _choose_folder(beside, found.names, options)
    return scene_of(path, found, FileFinder(folder), folder, factor, options, beside)


def scene_of(
    path: Path, found: Reconstruction, finder: FileFinder, folder: Path, factor: int, options: SceneOptions,
    beside: Path | None = None,
) -> Scene:  # fmt: skip
    """The scene of a reconstruction whose pictures, `factor` times smaller than full size, lie in a folder. beside: where masks
    are, else in `path`."""
    listed = finder.find_all(found.names)
    _tell_left_out(path, folder, found, listed)
    found = found.only([index for index, picture in enumerate(listed) if picture is not None])
    pictures = [picture for picture in listed if picture is not None]
    names = [clean_name(name) for name in found.names]
    masks = masks_of(beside or path, factor, names) if options.masks else [None] * len(names)
    described = zip(names, pictures, found.cameras, masks, strict=True)
    photographs = photographs_of(path, described, factor, options.downscale)
    photographs, space = _placed(path, found, photographs, options)
    kind = "colmap" if recognises(path) else "program"
    return Scene(**vars(space), path=path, kind=kind, splits=hold_out(photographs), held_out=HELD_OUT_BY_NAME)


def reconstruction_of(path: Path) -> Reconstruction:
    """The largest of the reconstructions that COLMAP wrote into a scene's folder. UserError where all are damaged."""
    read, errors = {}, []
    for folder in _model_folders(_scene_folder(path)):
        try:
            read[folder] = read_reconstruction(folder)
        except UserError as error:
            errors.append(error)
    if not read:
        raise errors[0]
    best = max(read, key=lambda folder: len(read[folder].names))
    if (count := len(read) + len(errors)) > 1:
        parts = ", ".join(f"{folder.name}: {len(read[folder].names)}" for folder in read)
        text = f"COLMAP split the capture into {count} parts; reading {best.name}, the largest (images: {parts})"
        notice(best.parent, text)
    return read[best]


def _model_folders(path: Path) -> list[Path]:
    """The folders of a scene's reconstructions: those of the first of MODELS where there are any, else the scene's own."""
    found = (sorted(folder for folder in path.glob(pattern) if model_suffix(folder)) for pattern in MODELS)
    suffix = model_suffix(path)
    own = [path] if suffix and (path / f"{PARTS[1]}{suffix}").is_file() else []
    return next(filter(None, found), own)


def _scene_folders(path: Path) -> list[Path]:
    return [path, *(folder for pattern in UNDISTORTED for folder in sorted(path.glob(pattern)))]


def _scene_folder(path: Path) -> Path:
    """Where a reconstruction and its pictures lie: in `path`, else in one of UNDISTORTED; else where a reconstruction is."""
    folders = list(filter(_model_folders, _scene_folders(path)))
    return next((folder for folder in folders if next(folder.glob("images*/"), None)), folders[0])


def _choose_folder(path: Path, names: tuple[str, ...], options: SceneOptions) -> tuple[Path, int]:
    """The folder of pictures images_K with the largest K up to the downscale, and K (1 for images). Passes over folders that lack
    most pictures or (where wanted) masks, or whose pictures are not K times smaller than those in images."""
    has_folder = next(path.glob("images*/"), None) or not any(FileFinder(path).find_all(names))
    folders = picture_folders(path) if has_folder else {1: path}
    found = {k: [file for file in FileFinder(folder).find_all(names) if file] for k, folder in folders.items()}
    sizes = {k: read_header(pictures[0]).size for k, pictures in found.items() if pictures}

    def is_usable(k: int) -> bool:
        full = zip(sizes[k], sizes[1], strict=True) if k in sizes and 1 in sizes else ()
        return len(found[k]) > len(names) / 2 and all(abs(small - large / k) <= 1.0 for small, large in full)

    usable = [k for k in sorted(folders) if k == 1 or is_usable(k)] or [min(folders)]
    masked = [k for k in usable if options.masks and masks_folder(path, k).is_dir()]
    factor = choose_factor(path, masked or usable, options.downscale)
    return folders[factor], factor


def _tell_left_out(path: Path, folder: Path, found: Reconstruction, listed: list[Path | None]) -> None:
    """UserError where no picture is there; a Notice of pictures that are gone, and of those that have no pose."""
    gone = [name for name, picture in zip(found.names, listed, strict=True) if picture is None]
    if len(gone) == len(listed):
        remedy = "no image of the reconstruction has its picture"
        raise UserError("picture not found", where=folder / gone[0], remedy=remedy)
    of = f"{len(gone)} of {len(listed)} images of the reconstruction"
    notice(folder, f"{of} have no picture and are left out", gone)
    known = {picture for picture in listed if picture is not None}
    stored = (p for p in folder.rglob("*") if p.suffix.lower() in PICTURE_SUFFIXES and p not in known)
    unposed = sorted(p.relative_to(folder).as_posix() for p in stored if not is_hidden(p))
    unposed = [name for name in unposed if not name.startswith("masks")]  # where these lie beside
    of = f"{len(unposed)} of {len(known) + len(unposed)} pictures"
    notice(folder, f"{of} have no pose in the reconstruction and are left out", unposed)


def _placed(
    path: Path, found: Reconstruction, photographs: list[Photograph], options: SceneOptions
) -> tuple[tuple[Photograph, ...], Space]:
    """The photographs in the training frame, and what a Scene says of the space."""
    P, points = space.viewing_poses(found.cameras), space.PointCloud(found.places, found.tracks, found.seen)
    if points.suffices and not options.spherify and faces_forward(P):
        if options.up is not None:
            raise UserError("which way is up is not asked of a forward-facing scene", where=UP, found=str(path),
                            remedy="leave it out, or use --spherify")  # fmt: skip
        placed = moved(photographs, space.frame_forward(P, space.nearest_depth(P, points)))
        try:
            scene_space = space.space_forward(placed)
            notice(path, "the cameras look forward; --spherify reads it as seen from all around")
            return placed, scene_space
        except UserError as error:  # wide lenses, cameras that walk ahead
            wide = f"the cameras look forward, but {error.found} sees too far aside for NDC"
            notice(path, f"{wide}; reading it as seen from all around")
    frame = _frame_of(P, options.up)
    placed = moved(photographs, frame)
    in_frame = replace(points, places=frame.points(points.places)) if points.suffices else None
    opaque = not may_be_transparent(placed)
    if in_frame is None and not opaque:  # training.posing.depths finds points of opaque ones
        notice(path, f"{len(found.places)} points are too few for a box; it is a guess: set --aabb")
    return placed, space.space_of_capture([photograph.camera for photograph in placed], in_frame, opaque=opaque)


def _frame_of(P: np.ndarray, up: Direction | None) -> space.Frame:
    """The training frame of a capture that is not forward-facing. up: the option."""
    frame = space.frame_about_focus(P)
    return frame if up is None else frame._replace(axes=frame.axes @ axes_of(up))


def sparse_points(scene: Scene) -> Reconstruction | None:
    """The reconstruction behind a COLMAP scene that is not in NDC, its points in the training frame; None for others. UserError
    where it is damaged."""
    if scene.kind != "colmap" or scene.ndc:
        return None
    found, options = reconstruction_of(scene.path), SceneOptions(**scene.notes)  # type: ignore[arg-type]
    names = {photograph.name for split in scene.splits.values() for photograph in split}
    pictured = [camera for name, camera in zip(found.names, found.cameras, strict=True) if clean_name(name) in names]
    frame = _frame_of(space.viewing_poses(pictured), options.up)
    return replace(found, places=frame.points(found.places))
