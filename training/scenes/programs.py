"""Scenes whose cameras another program found: Metashape, RealityCapture, Polycam, Record3D, 3D Scanner App, OpenSfM, Bundler.

Each is recognised by what its file says, and becomes a Reconstruction, which training.scenes.colmap makes a scene of. Readers
index and convert without checks: _refusing_damage turns what that raises into a UserError that names program and file.
docs/scenes.md says how to export. Notation: world_T_camera [4, 4] in OpenGL axes.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from console.json_text import read_json_file
from training.scenes.colmap import scene_of
from training.scenes.colmap_files import OPENGL_FROM_OPENCV, Reconstruction
from training.scenes.files import FileFinder
from training.scenes.lens import EQUIRECTANGULAR, FISHEYE, MODELS, PERSPECTIVE, Model
from training.scenes.picture_headers import read_header
from training.scenes.poses import pose
from training.scenes.scene import Camera, Scene, camera_of
from training.scenes.scene_options import SceneOptions
from training.scenes.space import rows_in_picture

MOST_JSON_BYTES = 512 << 20  # reconstructions of OpenSfM hold all points
PINHOLE = MODELS["PINHOLE"]
# What Python, its libraries and NumPy raise for values that are missing or make no sense.
DAMAGED = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, OSError, csv.Error, ElementTree.ParseError,
)  # fmt: skip
Numbers = Sequence[float] | np.ndarray
Cameras = Mapping[str, Camera]  # by the names of their pictures


@contextmanager
def _refusing_damage(program: str, file: Path) -> Iterator[None]:
    """UserError for what a reader raises at a file that is not as the program writes it."""
    try:
        yield
    except DAMAGED as error:
        found = f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)
        raise UserError(f"not an export of {program}, or a damaged one", where=file, found=found[:80],
                        remedy="export it again") from error  # fmt: skip


def _numbers(values: Any, *shape: int) -> np.ndarray:
    """Finite numbers float64 of that shape. ValueError or TypeError for anything else."""
    numbers = np.array(values, np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError("a number that is not finite")
    return numbers.reshape(shape)


def _camera(
    file: Path, name: str, world_T_camera: Any, size: Numbers, focal: Numbers, centre: Numbers,
    model: Model = PINHOLE, coefficients: Mapping[str, float] = MappingProxyType({}),
) -> Camera:  # fmt: skip
    """A camera; focal lengths and centre in pixels. UserError or ValueError where its pose or its lens make no sense."""
    named = {"fx": focal[0], "fy": focal[-1], "cx": centre[0], "cy": centre[1], **coefficients}
    values = dict(zip(named, _numbers(list(named.values()), -1).tolist(), strict=True))
    where, (width, height) = f"{file} {name}", _numbers(size, 2).tolist()
    return camera_of(model, values, (width, height), pose(world_T_camera, where), where)


def _reconstruction(cameras: Cameras, points: Any = (), colours: Any = (), seen: Any = None) -> Reconstruction:
    """Sorted by name. points, colours: [M, 3]; seen: by name, the rows of the points that it shows; or None."""
    if not cameras:
        raise ValueError("no camera has a pose")
    names = sorted(cameras)
    places, rgb = (_numbers(values, -1, 3) for values in (points, colours))
    shown = [rows_in_picture(cameras[name], places) if seen is None else seen[name] for name in names]
    tracks = np.bincount(np.concatenate(shown), minlength=len(places))
    return Reconstruction(tuple(names), tuple(cameras[name] for name in names), places,
                          np.clip(rgb, 0, 255).astype(np.uint8), tracks, tuple(shown))  # fmt: skip


# --- Agisoft Metashape ------------------------------------------------------------------------------------------------

MOST_BYTES = 256 << 20
MOST_SKEW = 1e-3  # b2, of the focal length: no lens here is skewed
KINDS = {"frame": PERSPECTIVE, "fisheye": FISHEYE, "spherical": EQUIRECTANGULAR}
# By our names: theirs.
METASHAPE_COEFFICIENTS = {"k1": "k1", "k2": "k2", "k3": "k3", "k4": "k4", "p1": "p2", "p2": "p1"}


def _read_metashape(file: Path, _: SizeOf) -> Reconstruction:
    """A camera's transform is chunk_T_camera, OpenCV axes. Of its lens, fx = f + b1; cx and cy count from the middle of the
    picture (Metashape's manual, "Camera models")."""
    cameras: dict[str, Camera] = {}
    for chunk in _document(file).iter("chunk"):
        sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
        parts = {part.get("id"): _transform(part) for part in chunk.iter("component")}
        for camera in chunk.iter("camera"):
            label, written = camera.get("label") or "", camera.findtext("transform")
            if written is None:
                continue
            sensor = sensors.get(camera.get("sensor_id"))
            if not label or label in cameras or sensor is None:
                raise ValueError(f"the label {label!r} comes twice, is empty or of a sensor that is not there")
            frames = (parts.get(camera.get("component_id")), _transform(chunk), np.eye(4))
            world_T_chunk = next(frame for frame in frames if frame is not None)
            world_T_camera = world_T_chunk @ _numbers(written.split(), 4, 4) @ OPENGL_FROM_OPENCV
            cameras[label] = _metashape_camera(file, label, world_T_camera, sensor)
    return _reconstruction(cameras)


def _document(file: Path) -> ElementTree.Element:
    """The root of an XML file in UTF-8 without entities of its own, which could grow or lead to other files."""
    if file.stat().st_size > MOST_BYTES:
        raise ValueError(f"more than {MOST_BYTES >> 20} MiB")
    text = file.read_text(encoding="utf-8-sig")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("a document type, which Metashape does not write")
    return ElementTree.fromstring(text)


def _transform(element: ElementTree.Element) -> np.ndarray | None:
    """world_T_chunk [4, 4] of a chunk or a component: rotation, translation, scale; None where there is none."""
    if (found := element.find("transform")) is None:
        return None
    R = _numbers(found.findtext("rotation", "1 0 0 0 1 0 0 0 1").split(), 3, 3)
    t = _numbers(found.findtext("translation", "0 0 0").split(), 3)
    return np.vstack([np.column_stack([_numbers(found.findtext("scale", "1"), 1) * R, t]), [0, 0, 0, 1]])


def _metashape_camera(file: Path, label: str, world_T_camera: np.ndarray, sensor: ElementTree.Element) -> Camera:
    kind, where = sensor.get("type", "frame"), f"{file} {label}"
    if kind not in KINDS:
        raise UserError("this lens model is not supported", where=where, expected=", ".join(KINDS), found=kind[:40],
                        remedy="export undistorted photographs")  # fmt: skip
    found = sensor.findall("calibration")
    calibration = next((one for one in found if one.get("class") == "adjusted"), found[-1] if found else None)
    resolution = sensor.find("resolution")
    if resolution is None or (calibration is None and kind != "spherical"):
        raise ValueError(f"the sensor of {label} without resolution or calibration")

    def number(name: str) -> float:
        return float("0" if calibration is None else calibration.findtext(name, "0"))

    size = _numbers([resolution.get("width"), resolution.get("height")], 2)
    f = number("f") or number("fy")
    fx = number("fx") or f + number("b1")
    if abs(number("b2")) > MOST_SKEW * abs(f):
        raise UserError("a skewed lens is not supported", where=where, found=f"b2 {number('b2'):g}",
                        remedy="calibrate without b2, or export undistorted photographs")  # fmt: skip
    centre = (size[0] / 2 + number("cx"), size[1] / 2 + number("cy")) if number("f") else (number("cx"), number("cy"))
    coefficients = {ours: number(theirs) for ours, theirs in METASHAPE_COEFFICIENTS.items()}
    return _camera(file, label, world_T_camera, size, (fx, f), centre, Model(KINDS[kind], ()), coefficients)


LOOKED_FOR = "an export of Metashape, RealityCapture, Polycam, Record3D, 3D Scanner App, OpenSfM or Bundler"
HEAD_BYTES = 4096  # of a file that tell what wrote it
FILM_MM = 36.0  # the longer side of a picture that focal lengths in millimetres refer to
UNKNOWN_SIZE = (2, 2)  # of pictures that are not there
SizeOf = Callable[[str], tuple[int, int]]  # width and height of the picture of that name


class Program(NamedTuple):
    name: str
    files: tuple[str, ...]  # patterns of those that it writes into a folder
    wrote: Callable[[bytes], bool]  # whether it wrote a file, by the first HEAD_BYTES
    read: Callable[[Path, SizeOf], Reconstruction]  # of the first such file
    pictures: tuple[str, ...] = ("images", ".")  # where its pictures lie: the first folder of these that is there


def recognises(path: Path) -> bool:
    return _found(path) is not None


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the cameras and the headers of the pictures."""
    found = _found(path)
    assert found is not None
    program, file, folder = found
    finder = FileFinder(folder, path)

    def size_of(name: str) -> tuple[int, int]:
        picture = finder.find(name)
        return UNKNOWN_SIZE if picture is None else read_header(picture).size

    with _refusing_damage(program.name, file):
        reconstruction = program.read(file, size_of)
    return scene_of(path, reconstruction, finder, folder, 1, options)


def _found(path: Path) -> tuple[Program, Path, Path] | None:
    """The program, the first file that it wrote, and the folder of its pictures."""
    for program in PROGRAMS:
        folder = next((path / name for name in program.pictures if (path / name).is_dir()), None)
        for file in (file for pattern in program.files for file in sorted(path.glob(pattern)) if file.is_file()):
            with file.open("rb") as opened:
                if program.wrote(opened.read(HEAD_BYTES)) and folder is not None:
                    return program, file, folder
    return None


# --- RealityCapture, RealityScan --------------------------------------------------------------------------------------

COLUMNS = ("x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
COEFFICIENTS: tuple[str, ...] = ("k1", "k2", "k3", "k4", "p1", "p2")  # the last of COLUMNS


def _is_realitycapture(head: bytes) -> bool:
    lines = head.decode("utf-8-sig", errors="replace").lower().splitlines()
    return any(line.startswith("#name") and "heading" in line for line in lines[:5])


def _read_realitycapture(file: Path, size_of: SizeOf) -> Reconstruction:
    """Heading, pitch and roll in degrees, where a camera of zeros looks down and its top is north; lengths in millimetres of a
    picture FILM_MM long."""
    lines = [line for line in file.read_text(encoding="utf-8-sig", errors="replace").splitlines() if line.strip()]
    first = next(index for index, line in enumerate(lines) if line.lower().startswith("#name"))
    separator = ";" if ";" in lines[first] else ","
    head = [column.strip().lower() for column in lines[first].split(separator)]
    if missing := [column for column in COLUMNS[:9] if column not in head]:
        raise ValueError(f"no column {', '.join(missing)}")
    stated = next((line.split()[-1] for line in lines[:first] if line.lower().startswith("#cameras ")), None)
    listed = lines[first + 1 :]
    if stated not in (None, str(len(listed))):
        raise ValueError(f"{len(listed)} cameras where it counts {stated}")
    cameras = {}
    for row in csv.reader(listed, delimiter=separator):
        name, values = row[0], dict(zip(head, row, strict=False))
        if len(row) != len(head) or name in cameras:
            raise ValueError(f"{name} comes twice, or its line has another number of columns than the first")
        numbers = _numbers([values.get(column) or 0 for column in COLUMNS], len(COLUMNS))
        x, y, z, heading, pitch, roll, f, px, py, *rest = numbers
        R = Rotation.from_euler("ZXY", [-heading, pitch, roll], degrees=True).as_matrix()
        width, height = size_of(name)
        scale = max(width, height) / FILM_MM
        centre = 0.5 * width + scale * px, 0.5 * height + scale * py
        cameras[name] = _camera(file, name, np.column_stack([R, [x, y, z]]), (width, height), [scale * f], centre,
                                coefficients=dict(zip(COEFFICIENTS, rest, strict=True)))  # fmt: skip
    return _reconstruction(cameras)


# --- apps for phones --------------------------------------------------------------------------------------------------


def _read_polycam(first: Path, _: SizeOf) -> Reconstruction:
    """keyframes/cameras/TIME.json: t_ij of a camera-to-world matrix in OpenGL axes, and the lens in pixels."""
    cameras = {}
    for file in sorted(first.parent.glob("*.json")):
        with _refusing_damage("Polycam", file):
            values = read_json_file(file)
            matrix = [[values[f"t_{row}{column}"] for column in range(4)] for row in range(3)]
            lens = [values[key] for key in ("width", "height", "fx", "fy", "cx", "cy")]
            cameras[file.stem] = _camera(file, file.stem, matrix, lens[:2], lens[2:4], lens[4:])
    return _reconstruction(cameras)


def _read_scanner_app(first: Path, size_of: SizeOf) -> Reconstruction:
    """frame_N.json of ARKit: cameraPoseARFrame, camera-to-world in OpenGL axes, and intrinsics [3, 3] in pixels."""
    cameras = {}
    for file in sorted(first.parent.glob("frame_*.json")):
        with _refusing_damage("3D Scanner App", file):
            values = read_json_file(file)
            matrix, K = _numbers(values["cameraPoseARFrame"], 4, 4), _numbers(values["intrinsics"], 3, 3)
            # by rows or, as ARKit has them in memory, by columns
            matrix = matrix.T if np.any(matrix[3, :3]) else matrix
            K = K.T if np.any(K[2, :2]) else K
            cameras[file.stem] = _camera(file, file.stem, matrix, size_of(file.stem), (K[0, 0], K[1, 1]), K[:2, 2])
    return _reconstruction(cameras)


RECORD3D_KEYS = (b'"poses"', b'"K"', b'"initPose"', b'"frameTimestamps"', b'"perFrameIntrinsicCoeffs"')


def _read_record3d(file: Path, _: SizeOf) -> Reconstruction:
    """metadata.json: poses [x, y, z, w of a quaternion, position] in OpenGL axes; K by columns, or a lens for each frame."""
    values = read_json_file(file)
    poses, K, size = _numbers(values["poses"], -1, 7), _numbers(values["K"], 3, 3).T, (values["w"], values["h"])
    lenses = values.get("perFrameIntrinsicCoeffs")
    lenses = [[K[0, 0], K[1, 1], K[0, 2], K[1, 2]]] * len(poses) if lenses is None else _numbers(lenses, len(poses), 4)
    cameras = {}
    for index, (row, lens) in enumerate(zip(poses, lenses, strict=True)):
        world_T_camera = np.column_stack([Rotation.from_quat(row[:4]).as_matrix(), row[4:]])
        cameras[f"{index}"] = _camera(file, f"{index}", world_T_camera, size, lens[:2], lens[2:])
    return _reconstruction(cameras)


# --- OpenSfM, OpenDroneMap --------------------------------------------------------------------------------------------

# projection_type: the projection, and the coefficients of the lens
OPENSFM = {
    "perspective": (PERSPECTIVE, ("k1", "k2")), "simple_radial": (PERSPECTIVE, ("k1", "k2")),
    "radial": (PERSPECTIVE, ("k1", "k2")), "brown": (PERSPECTIVE, ("k1", "k2", "k3", "p1", "p2")),
    "fisheye": (FISHEYE, ("k1", "k2")), "fisheye_opencv": (FISHEYE, ("k1", "k2", "k3", "k4")),
    "spherical": (EQUIRECTANGULAR, ()), "equirectangular": (EQUIRECTANGULAR, ()),
}  # fmt: skip


def _read_opensfm(file: Path, _: SizeOf) -> Reconstruction:
    """The largest of the reconstructions: cameras in units of the picture's longer side, shots as camera_T_world."""
    found = max(read_json_file(file, MOST_JSON_BYTES), key=lambda part: len(part["shots"]))
    cameras = {}
    for name, shot in found["shots"].items():
        lens = found["cameras"][shot["camera"]]
        rotation, t = _numbers(shot["rotation"], 3), _numbers(shot["translation"], 3)
        camera_T_world = np.column_stack([Rotation.from_rotvec(rotation).as_matrix(), t])
        kind = str(lens["projection_type"])
        if kind not in OPENSFM:
            raise UserError("this lens model is not supported", where=file, expected=", ".join(OPENSFM), found=kind[:40],
                            remedy="undistort the pictures first (opensfm undistort)")  # fmt: skip
        projection, keys = OPENSFM[kind]
        width, height = size = lens["width"], lens["height"]
        scale, fx = max(size), lens["focal_x"] if "focal_x" in lens else lens.get("focal", 0.0)
        focal = [scale * fx, scale * lens.get("focal_y", fx)]
        coefficients = {key: lens.get(key, 0.0) for key in keys}
        middle = scale * lens.get("c_x", 0.0) + 0.5 * width, scale * lens.get("c_y", 0.0) + 0.5 * height
        world_T_camera = np.linalg.inv(pose(camera_T_world, f"{file} {name}")) @ OPENGL_FROM_OPENCV
        cameras[name] = _camera(file, name, world_T_camera, size, focal, middle, Model(projection, ()), coefficients)
    points = (found.get("points") or {}).values()
    places = [point["coordinates"] for point in points]
    return _reconstruction(cameras, places, [point.get("color", (0, 0, 0)) for point in points])


# --- Bundler ----------------------------------------------------------------------------------------------------------

LISTS = ("list.txt", "bundle.list.txt", "bundle.out.list.txt")  # the pictures' names, beside the file or above


def _read_bundler(file: Path, size_of: SizeOf) -> Reconstruction:
    """bundle.out 0.3: counts; per camera f, k1, k2, R, t of camera_T_world in OpenGL axes; per point place, colour and views."""
    names = (*LISTS, file.name + ".list.txt")
    lists = (folder / name for folder in (file.parent, file.parent.parent) for name in names)
    listing = next((found for found in lists if found.is_file()), None)
    if listing is None:
        raise ValueError("no list.txt beside it, which names the pictures")
    lines = listing.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    names = [line.split()[0] for line in lines if line.strip()]
    words = iter(file.read_text(encoding="utf-8", errors="replace").partition("\n")[2].split())

    def take(count: int) -> np.ndarray:
        return _numbers(list(itertools.islice(words, count)), count)

    def whole(what: str, most: int) -> int:
        value = take(1)[0]
        if not 0 <= value <= most or value != int(value):
            raise ValueError(f"{what} {value:g}, where 0 to {most} can be")
        return int(value)

    length = file.stat().st_size
    count, points = whole("number of cameras", len(names)), whole("number of points", length // 12)  # bytes of each
    cameras, seen = {}, {}
    for name in names[:count]:
        f, k1, k2, *rest = take(15)
        if f == 0:
            continue  # it has no pose
        camera_T_world = pose(np.column_stack([np.reshape(rest[:9], (3, 3)), rest[9:]]), f"{file} {name}")
        width, height = size = size_of(name)
        cameras[name] = _camera(file, name, np.linalg.inv(camera_T_world), size, [f], (width / 2, height / 2),
                                coefficients={"k1": float(k1), "k2": float(k2)})  # fmt: skip
        seen[name] = []
    table = np.zeros((points, 6))
    for row in range(points):
        table[row] = take(6)
        for view in take(4 * whole("number of views", length))[::4]:
            if 0 <= view < count and names[int(view)] in seen:
                seen[names[int(view)]].append(row)
    rows = {name: np.array(shown, np.int64) for name, shown in seen.items()}
    return _reconstruction(cameras, table[:, :3], table[:, 3:], rows)


PROGRAMS = (
    Program("Metashape", ("*.[xX][mM][lL]",), lambda head: b"<document" in head and b"<chunk" in head, _read_metashape),
    Program("RealityCapture", ("*.[cC][sS][vV]",), _is_realitycapture, _read_realitycapture),
    Program("Polycam", ("keyframes/corrected_cameras/*.json",), lambda head: b'"t_00"' in head, _read_polycam,
            ("keyframes/corrected_images", ".")),
    Program("Polycam", ("keyframes/cameras/*.json",), lambda head: b'"t_00"' in head, _read_polycam, ("keyframes/images", ".")),
    Program("3D Scanner App", ("frame_*.json",), lambda head: b'"cameraPoseARFrame"' in head, _read_scanner_app, (".",)),
    Program("Record3D", ("metadata.json",), lambda head: any(key in head for key in RECORD3D_KEYS), _read_record3d,
            ("rgb", "rgbd")),
    Program("OpenSfM", ("reconstruction.json", "opensfm/reconstruction.json"), lambda head: True, _read_opensfm),
    Program("Bundler", ("bundle*.out", "bundle/bundle*.out"), lambda head: head.startswith(b"# Bundle file"), _read_bundler),
)  # fmt: skip
