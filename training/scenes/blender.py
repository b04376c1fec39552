"""NeRF-synthetic ("Blender") scenes: transforms_{train,val,test}.json and RGBA pictures over white.

camera_angle_x is the horizontal field of view in radians; poses are OpenGL camera-to-world already.
Objects stand within about 1.5 of the origin, cameras at 4.03: near 2, far 6. z is up, so the pack's y-up
grid frame is turned.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from console import UserError
from training.scenes.pictures import PictureLoader, picture_size, shrunk_size
from training.scenes.poses import field_of_view, frames_of, pose, read_json
from training.scenes.scene import Camera, Photograph, Scene, SceneOptions

LOOKED_FOR = "transforms_train.json (Blender)"
SPLITS = ("train", "val", "test")
NEAR, FAR = 2.0, 6.0
HALF_SIDE = 1.5  # of the box that holds the content
WORLDSPACE_T_OPENGL = np.array(
    [[-1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=np.float64
)  # docs/format.md, "Coordinate frames"


def recognises(path: Path) -> bool:
    """Whether the folder looks like a Blender scene."""
    return (path / "transforms_train.json").is_file()


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the poses and checks every picture's header; pictures are decoded when asked for."""
    splits = {}
    for split in SPLITS:
        description = path / f"transforms_{split}.json"
        if description.is_file():
            splits[split] = _read_split(path, description, options.downscale)
    return Scene(
        path=path,
        kind="blender",
        splits=splits,
        near=NEAR,
        far=FAR,
        aabb=np.array([[-HALF_SIDE] * 3, [HALF_SIDE] * 3]),
        worldspace_T_opengl=WORLDSPACE_T_OPENGL,
        notes=vars(options),
    )


def _read_split(path: Path, description: Path, downscale: int) -> tuple[Photograph, ...]:
    document = read_json(description)
    frames = frames_of(document, description)
    angle = field_of_view(document, "camera_angle_x", description)
    photographs, first_size = [], None
    for index, frame in enumerate(frames):
        world_T_camera = pose(frame.get("transform_matrix"), f"{description} frame {index}")
        picture = _picture_path(path, frame["file_path"])
        source = picture_size(picture)
        first_size = first_size or source
        if source != first_size:
            raise UserError(
                "the picture is of another size",
                where=picture,
                expected="{}x{}".format(*first_size),
                found="{}x{}".format(*source),
                remedy="all pictures of a Blender scene share one size",
            )
        size = shrunk_size(*source, downscale)
        focal = float(0.5 * source[0] / np.tan(0.5 * angle))
        camera = Camera(world_T_camera, *source, focal, focal, 0.5 * source[0], 0.5 * source[1]).resized(*size)
        name = Path(frame["file_path"]).with_suffix("").as_posix().removeprefix("./")
        photographs.append(Photograph(name, camera, PictureLoader(picture, source, size)))
    return tuple(photographs)


def _picture_path(path: Path, file_path: str) -> Path:
    """The picture that a frame names, with or without its .png."""
    named = path / file_path
    if not named.name:
        raise UserError("a frame without a picture", where=path, expected="a file_path", found=repr(file_path))
    return named if named.suffix.lower() in (".png", ".jpg", ".jpeg") else named.with_name(named.name + ".png")
