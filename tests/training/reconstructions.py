"""Reconstructions as COLMAP would write them, of known points seen by known cameras. pycolmap itself writes them."""

from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from scenepack.constants import NDC_NEAR
from training.scenes.poses import look_at

SIZE = (48, 36)
LENSES = {
    "SIMPLE_PINHOLE": (50.0, 24.0, 18.0),
    "PINHOLE": (50.0, 51.0, 23.0, 19.0),
    "SIMPLE_RADIAL": (50.0, 24.0, 18.0, 0.05),
    "RADIAL": (50.0, 24.0, 18.0, 0.06, -0.02),
    "OPENCV": (50.0, 51.0, 23.0, 19.0, 0.08, -0.02, 0.003, -0.002),
    "FULL_OPENCV": (50.0, 51.0, 23.0, 19.0, 0.08, -0.02, 0.003, -0.002, 0.01, 0.02, -0.01, 0.004),
    "FOV": (50.0, 51.0, 23.0, 19.0, 0.2),
    "SIMPLE_FISHEYE": (20.0, 24.0, 18.0),
    "FISHEYE": (20.0, 21.0, 23.0, 19.0),
    "SIMPLE_RADIAL_FISHEYE": (20.0, 24.0, 18.0, 0.03),
    "RADIAL_FISHEYE": (20.0, 24.0, 18.0, 0.03, -0.01),
    "OPENCV_FISHEYE": (20.0, 21.0, 23.0, 19.0, 0.03, -0.01, 0.004, -0.001),
    "THIN_PRISM_FISHEYE": (20.0, 21.0, 23.0, 19.0, 0.03, -0.01, 0.003, -0.002, 0.004, -0.001, 0.002, -0.001),
    "EQUIRECTANGULAR": SIZE,
}
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def side_by_side(count: int = 10) -> np.ndarray:
    """Cameras that look along -z from about (1, -2, 3.5), y up."""
    offsets = np.random.default_rng(1).uniform(-0.3, 0.3, (count, 3)) * [1, 1, 0.1]
    up = np.array([0.0, 1.0, 0.0])
    return np.stack([look_at(np.add(o, (1, -2, 3.5)), np.array([0, 0, 1.0]) + 0.05 * o, up) for o in offsets])


def ball(count: int = 150, radius: float = 0.5) -> np.ndarray:
    """Points [M, 3] within a ball about (1, -2, 0.5)."""
    return np.random.default_rng(0).uniform(-1, 1, (count, 3)) * radius / np.sqrt(3) + [1.0, -2.0, 0.5]


def write_colmap(
    path: Path, P: np.ndarray, points: np.ndarray, models: tuple[str, ...] = ("OPENCV",), folder: str = "sparse/0",
    mistakes: int = 0, unposed: int = 0,
) -> Path:  # fmt: skip
    """A folder with a reconstruction and plain pictures. models: taken in turn by the images.

    mistakes: points far away, each matched in two images only. unposed: pictures that the reconstruction does not know.
    """
    made = pycolmap.Reconstruction()
    for number, model in enumerate(models, 1):
        lens = pycolmap.Camera(camera_id=number, model=model, width=SIZE[0], height=SIZE[1], params=LENSES[model])
        made.add_camera_with_trivial_rig(lens)
    rng = np.random.default_rng(2)
    shown: list[list[tuple[int, int]]] = [[] for _ in points]
    wrong: list[tuple[int, int, int]] = []
    for index, world_T_camera in enumerate(P):
        camera_T_world = np.linalg.inv(world_T_camera @ FLIP)
        lens = made.cameras[1 + index % len(models)]
        local = points @ camera_T_world[:3, :3].T + camera_T_world[:3, 3]
        pixels = np.array([lens.img_from_cam(one) if one[2] > 0 else (-1.0, -1.0) for one in local])
        inside = (local[:, 2] > 0) & np.all((pixels > 0) & (pixels < SIZE), axis=1)
        keypoints = np.concatenate([pixels[inside], rng.uniform(0, 30, (mistakes, 2))])
        for place, point in enumerate(np.nonzero(inside)[0]):
            shown[point].append((index + 1, place))
        wrong += [(k, index + 1, len(keypoints) - 1 - k) for k in range(mistakes)]
        name = f"{'left' if index % 2 else 'right'}/{index:02d}.png"
        image = pycolmap.Image(name=name, keypoints=keypoints, camera_id=lens.camera_id, image_id=index + 1)
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera_T_world[:3]))
    for point, seen in zip(points, shown, strict=True):
        if seen:
            made.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(*each) for each in seen]))
    wrong.sort()
    for (_, *first), (_, *second) in zip(wrong[::2], wrong[1::2], strict=False):
        track = pycolmap.Track([pycolmap.TrackElement(*first), pycolmap.TrackElement(*second)])
        made.add_point3D(rng.normal(size=3) * 200, track)
    (path / folder).mkdir(parents=True)
    made.write(path / folder)
    for index in range(len(P)):
        save_picture(path / "images" / f"{'left' if index % 2 else 'right'}/{index:02d}.png", index=index)
    for index in range(unposed):
        save_picture(path / "images" / f"lost_{index}.png")
    return path


def save_picture(file: Path, size: tuple[int, int] = SIZE, index: int = 0) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, (10 * index, 100, 50)).save(file)


def ndc_points(points: np.ndarray, width: float, height: float, focal: float, near: float = NDC_NEAR) -> np.ndarray:
    """World points [..., 3] (camera frame of the mean pose, z negative in front) in NDC space."""
    z = points[..., 2]
    return np.stack(
        [-2.0 * focal / width * points[..., 0] / z, -2.0 * focal / height * points[..., 1] / z, 1.0 + 2.0 * near / z],
        axis=-1,
    )
