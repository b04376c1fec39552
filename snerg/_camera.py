"""Camera: where a picture is taken from, and through which lens."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians, tan
from operator import index
from typing import TYPE_CHECKING, Any, Literal, get_args

from snerg._errors import SnergError, with_snerg_errors

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from scenepack.cameras import Camera as SceneCamera
    from scenepack.pack import Pack
    from viewer.rendering.camera import ViewCamera

Frame = Literal["grid", "world"]
Convention = Literal["opengl", "opencv", "colmap"]
NO_DISTORTION = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera. Make one with `look_at` or `from_pose`, or take one of `Scene.cameras`, `Scene.orbit`, `Photographs.cameras`."""

    pose: NDArray[np.float64]
    """Camera to frame, [4, 4], with OpenGL axes."""
    fx: float
    """Focal length along x, pixels."""
    fy: float
    """Focal length along y, pixels."""
    cx: float
    """Principal point from the left edge, pixels."""
    cy: float
    """Principal point from the upper edge, pixels."""
    width: int
    """Width of the picture, pixels."""
    height: int
    """Height of the picture, pixels."""
    distortion: tuple[float, ...] = NO_DISTORTION
    """OpenCV's k1, k2, p1, p2."""
    frame: Frame = "world"
    """The frame of `pose`: "grid" (y up) or "world" (of the photographs)."""
    name: str = ""
    """Name of the photograph; "" where it is none."""
    split: str = ""
    """Split of the photograph: "train", "test" or "val"."""

    def __post_init__(self) -> None:
        """Refuses what is no camera, also in copies by `dataclasses.replace`."""
        import numpy as np

        check_choice("frame", self.frame, Frame)
        size, pose = checked_size((self.width, self.height)), numbers(self.pose)
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise SnergError("is no pose", where="pose", expected="a finite matrix [4, 4]")
        for key, value in (("pose", pose), ("width", size[0]), ("height", size[1])):
            object.__setattr__(self, key, value)

    @staticmethod
    @with_snerg_errors
    def look_at(
        eye: ArrayLike,
        target: ArrayLike,
        *,
        up: ArrayLike = (0.0, 1.0, 0.0),
        fov: float = 39.0,
        size: tuple[int, int] = (800, 800),
        frame: Frame = "grid",
    ) -> Camera:
        """A camera at `eye` ([3]) that looks at `target` ([3]), with `up` ([3]) upwards.

        `fov` is the vertical field of view in degrees, `size` width and height in pixels, `frame` that of the vectors.

        Raises:
            SnergError: Where the eye is the target, or a number makes no sense.
        """
        import numpy as np

        from viewer.rendering.camera import ViewCamera

        vectors = [numbers(vector) for vector in (eye, target, up)]
        if any(vector.shape != (3,) or not np.isfinite(vector).all() for vector in vectors) or not vectors[2].any():
            raise SnergError("are no points and direction", where="eye, target, up", expected="three numbers each")
        if np.allclose(vectors[0], vectors[1], rtol=0, atol=1e-12):
            raise SnergError("is the same point as the target", where="eye", remedy="choose another target")
        pose = ViewCamera.look_at(vectors[0], vectors[1], vectors[2]).grid_T_camera
        return Camera.from_pose(pose, size=size, fov=fov, frame=frame)

    @staticmethod
    @with_snerg_errors
    def from_pose(
        pose: ArrayLike,
        *,
        size: tuple[int, int],
        convention: Convention = "opengl",
        fov: float | None = None,
        intrinsics: ArrayLike | None = None,
        distortion: tuple[float, ...] = NO_DISTORTION,
        frame: Frame = "world",
    ) -> Camera:
        """A camera by its pose, in the convention of another program.

        Args:
            pose: `opengl`: camera to frame, [4, 4] or [3, 4], axes x right, y up, z back (NeRF's datasets, Blender). `opencv`:
                the same with axes x right, y down, z forward. `colmap`: the seven numbers QW QX QY QZ TX TY TZ of a line of
                images.txt. (Scenes from COLMAP are turned and scaled as they are read: see `Photographs.cameras`.)
            size: Width and height in pixels.
            convention: Of `pose`.
            fov: Vertical field of view, degrees; the principal point is the middle then.
            intrinsics: In place of `fov`: fx, fy, cx, cy in pixels, or the matrix K [3, 3].
            distortion: OpenCV's k1, k2, p1, p2, also with k3, or the 12 numbers of docs/format.md ("Additional keys").
            frame: Of `pose`: "world" or "grid".

        Raises:
            SnergError: Where the numbers are no camera.
        """
        import numpy as np
        from scipy.spatial.transform import Rotation

        check_choice("convention", convention, Convention)
        matrix, given = np.eye(4), numbers(pose)
        if given.shape not in (((7,),) if convention == "colmap" else ((3, 4), (4, 4))) or not np.isfinite(given).all():
            expected = "7 finite numbers" if convention == "colmap" else "a finite matrix [4, 4] or [3, 4]"
            raise SnergError("is no pose", where="pose", expected=expected, found=f"an array {given.shape}")
        if convention == "colmap":
            if not given[:4].any():
                raise SnergError("is no rotation", where="pose", expected="QW QX QY QZ, not all 0")
            rotation = Rotation.from_quat(np.roll(given[:4], -1)).as_matrix()  # which has w last
            matrix[:3, :3], matrix[:3, 3] = rotation.T, -rotation.T @ given[4:]
        else:
            matrix[: len(given)] = given
            if not np.allclose(matrix[3], (0, 0, 0, 1)) or not np.linalg.det(matrix[:3, :3]):
                expected = "a rotation and a place, and 0 0 0 1 as the last row"
                raise SnergError("is no pose", where="pose", expected=expected, remedy="transpose it?")
        if convention != "opengl":
            matrix[:, 1:3] *= -1.0
        width, height = checked_size(size)
        if (fov is None) == (intrinsics is None):
            raise SnergError("a lens needs fov or intrinsics", expected="one of them")
        focal = 0.0 if fov is None else 0.5 * height / tan(0.5 * radians(checked_fov(fov)))
        lens = numbers([focal, focal, 0.5 * width, 0.5 * height] if intrinsics is None else intrinsics)
        lens = lens[[0, 1, 0, 1], [0, 1, 2, 2]] if lens.shape == (3, 3) else lens
        if lens.shape != (4,) or not np.isfinite(lens).all() or (lens[:2] <= 0).any():
            raise SnergError("are no intrinsics", where="intrinsics", expected="fx, fy, cx, cy, or K [3, 3]")
        fx, fy, cx, cy = map(float, lens)
        distorted = numbers(distortion).ravel()
        if len(distorted) not in (4, 5, 12) or not np.isfinite(distorted).all():
            expected = "k1, k2, p1, p2, and perhaps k3; or 12 numbers"
            raise SnergError("is no distortion", where="distortion", expected=expected, found=distortion)
        return Camera(matrix, fx, fy, cx, cy, width, height, tuple(distorted.tolist()), frame)

    @with_snerg_errors
    def resized(self, width: int, height: int) -> Camera:
        """The same view as a picture of another size, in pixels.

        Raises:
            SnergError: Where that is no size.
        """
        width, height = checked_size((width, height))
        sx, sy = width / self.width, height / self.height
        lens = {"fx": self.fx * sx, "fy": self.fy * sy, "cx": self.cx * sx, "cy": self.cy * sy}
        return replace(self, width=width, height=height, **lens)


def check_choice(where: str, value: object, choices: Any) -> None:
    """Raises SnergError where `value` is none of a Literal's."""
    if value not in get_args(choices):
        raise SnergError("no such choice", where=where, expected=", ".join(get_args(choices)), found=repr(value))


def checked_size(size: Any) -> tuple[int, int]:
    """Width and height in pixels. Raises SnergError where `size` is something else."""
    try:
        width, height = map(index, size)
    except (TypeError, ValueError):
        width = height = 0
    if min(width, height) < 1:
        raise SnergError("is no size", where="size", expected="width and height in whole pixels", found=size)
    return width, height


def checked_fov(fov: Any) -> float:
    """A field of view in degrees. Raises SnergError where `fov` is something else."""
    if (degrees := numbers(fov)).shape or not 0.1 <= degrees < 179:
        raise SnergError("is no field of view", where="fov", expected="0.1 ... 179 degrees", found=fov)
    return float(degrees)


def numbers(value: Any) -> NDArray[np.float64]:
    """`value` as an array; a single NaN, which callers refuse, if it cannot be one."""
    import numpy as np

    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return np.full((), np.nan)


def camera_of(camera: SceneCamera, name: str, split: str) -> Camera:
    """The camera of a photograph."""
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    return Camera(camera.world_T_camera, *lens, camera.width, camera.height, camera.distortion, "world", name, split)


def camera_of_view(view: ViewCamera) -> Camera:
    """A camera of the renderer."""
    lens = view.fx, view.fy, view.cx, view.cy
    return Camera(view.grid_T_camera, *lens, view.width, view.height, view.distortion, "grid")


def view_of(camera: Camera, pack: Pack) -> ViewCamera:
    """The camera as the renderer of `pack` wants it."""
    import numpy as np

    from viewer.rendering.camera import ViewCamera, is_mirrored

    pose, near = camera.pose, 0.0
    if camera.frame == "world":
        pose, near = np.linalg.inv(pack.worldspace_T_opengl) @ pose, pack.near if camera.name else 0.0
    elif is_mirrored(pack) and np.linalg.det(pose[:3, :3]) > 0:
        pose = pose * [-1.0, 1.0, 1.0, 1.0]  # the grid frame is left-handed: the picture comes out the right way round
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    return ViewCamera(pose, *lens, camera.width, camera.height, 0.0, camera.distortion, near)
