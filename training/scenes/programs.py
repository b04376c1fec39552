"""Scenes whose cameras another program found: Metashape, RealityCapture, Polycam, Record3D, 3D Scanner App, OpenSfM, Bundler.

Each is recognised by what its file says, and becomes a Reconstruction, which training.scenes.colmap makes a scene of.
docs/scenes.md says how to export. Notation: world_T_camera [4, 4] in OpenGL axes; FLIP turns OpenCV's axes into those.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from console import UserError
from console.json_text import read_json_file
from training.scenes.colmap import scene_of
from training.scenes.colmap_files import LARGEST_SIDE, OPENGL_FROM_OPENCV, Reconstruction
from training.scenes.files import FileFinder
from training.scenes.lens import EQUIRECTANGULAR, FISHEYE, MODELS, PERSPECTIVE, Model
from training.scenes.pictures import picture_size
from training.scenes.poses import finite_numbers, pose
from training.scenes.scene import Camera, Scene
from training.scenes.scene_options import SceneOptions
from training.scenes.space import in_picture

MOST_JSON_BYTES = 512 << 20  # reconstructions of OpenSfM hold all points
PINHOLE = MODELS["PINHOLE"]
Numbers = Sequence[float] | np.ndarray


class ExportFile(NamedTuple):
    """A file of a program, for errors that name both."""

    program: str
    file: Path

    def damaged(self, found: str, where: str = "") -> UserError:
        return UserError(f"not an export of {self.program}, or a damaged one", where=f"{self.file} {where}".strip(),
                         found=found[:80], remedy="export it again")  # fmt: skip

    def json(self, kind: type) -> Any:
        try:
            value = read_json_file(self.file, MOST_JSON_BYTES)
        except (ValueError, OSError) as error:
            raise self.damaged(str(error)) from error
        if not isinstance(value, kind):
            raise self.damaged(f"{type(value).__name__} at the top")
        return value

    def numbers(self, values: Any, count: int, what: str) -> np.ndarray:
        """Finite numbers float64 [count]."""
        if (numbers := finite_numbers(values, count)) is None:
            raise self.damaged(f"{what} is no list of {count} numbers" if count > 1 else f"{what} is no number")
        return numbers

    def number(self, values: Mapping[str, Any], key: str, default: float | None = None) -> float:
        value, what = values.get(key, default), f"{key} of {values.get('name', 'a camera')}"
        return float(self.numbers([None if isinstance(value, bool) else value], 1, what)[0])

    def entry(self, values: Any, key: str, kind: type) -> Any:
        """The entry of an object under a key, of that type and not empty."""
        value = values.get(key) if isinstance(values, dict) else None
        if not isinstance(value, kind) or not value:
            raise self.damaged(f"no {key}")
        return value

    def camera(
        self, name: str, world_T_camera: Any, size: Numbers, focal: Numbers, centre: Numbers,
        model: Model = PINHOLE, coefficients: Mapping[str, float] = MappingProxyType({}),
    ) -> Camera:  # fmt: skip
        """A camera; focal lengths and centre in pixels. UserError where its pose or its lens make no sense."""
        width, height = (float(side) for side in size)
        numbers = [width, height, *focal, *centre, *coefficients.values()]
        good = np.isfinite(numbers).all() and 1 <= min(width, height) <= max(width, height) <= LARGEST_SIDE
        if not good or (model.projection != EQUIRECTANGULAR and min(focal) <= 0):
            found = ", ".join(f"{number:g}" for number in numbers)
            raise self.damaged(f"size and focal length must be positive numbers: {found}", name)
        values = {"fx": float(focal[0]), "fy": float(focal[-1]), "cx": float(centre[0]), "cy": float(centre[1])}
        intrinsics = model.intrinsics(values, width, height)
        world_T_camera = pose(world_T_camera, f"{self.file} {name}")
        return Camera(world_T_camera, round(width), round(height), *intrinsics, model.lens(coefficients))

    def reconstruction(
        self, cameras: Mapping[str, Camera], points: Any = (), colours: Any = (), seen: Any = None
    ) -> Reconstruction:
        """Sorted by name. points, colours: [M, 3]; seen: by name, the rows of the points that it shows; or None."""
        if not cameras:
            raise self.damaged("no camera has a pose")
        names = sorted(cameras)
        places, rgb = (np.array(values, np.float64).reshape(-1, 3) for values in (points, colours))
        if not np.isfinite(places).all() or len(rgb) != len(places):
            raise self.damaged("a point at no finite place, or without a colour")
        shown = [np.flatnonzero(in_picture(cameras[name], places)) if seen is None else seen[name] for name in names]
        tracks = np.bincount(np.concatenate(shown), minlength=len(places)) if len(places) else np.zeros(0)
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
    export = ExportFile("Metashape", file)
    cameras: dict[str, Camera] = {}
    for chunk in _document(file, export).iter("chunk"):
        sensors = {sensor.get("id"): sensor for sensor in chunk.iter("sensor")}
        parts = {part.get("id"): _transform(part, export) for part in chunk.iter("component")}
        whole = _transform(chunk, export)
        for camera in chunk.iter("camera"):
            label, written = camera.get("label") or "", camera.findtext("transform")
            if written is None:
                continue
            sensor = sensors.get(camera.get("sensor_id"))
            if not label or sensor is None:
                raise export.damaged("a camera without a label, or of a sensor that is not there", label)
            if label in cameras:
                raise export.damaged("a label that comes twice", label)
            chunk_T_camera = export.numbers(written.split(), 16, f"transform of {label}").reshape(4, 4)
            frames = (parts.get(camera.get("component_id")), whole, np.eye(4))
            world_T_chunk = next(frame for frame in frames if frame is not None)
            cameras[label] = _camera(label, world_T_chunk @ chunk_T_camera @ OPENGL_FROM_OPENCV, sensor, export)
    return export.reconstruction(cameras)


def _document(file: Path, export: ExportFile) -> ElementTree.Element:
    """The root of an XML file in UTF-8 without entities of its own, which could grow or lead to other files."""
    if file.stat().st_size > MOST_BYTES:
        raise export.damaged(f"more than {MOST_BYTES >> 20} MiB")
    try:
        text = file.read_text(encoding="utf-8-sig")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise export.damaged("a document type, which Metashape does not write")
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, UnicodeDecodeError, ValueError) as error:
        raise export.damaged(str(error)) from error


def _transform(element: ElementTree.Element, export: ExportFile) -> np.ndarray | None:
    """world_T_chunk [4, 4] of a chunk or a component: rotation, translation, scale; None where there is none."""
    if (found := element.find("transform")) is None:
        return None

    def numbers(name: str, default: str, count: int) -> np.ndarray:
        return export.numbers(found.findtext(name, default).split(), count, f"{name} of a chunk")

    R = numbers("rotation", "1 0 0 0 1 0 0 0 1", 9).reshape(3, 3)
    t = numbers("translation", "0 0 0", 3)
    return np.vstack([np.column_stack([numbers("scale", "1", 1) * R, t]), [0, 0, 0, 1]])


def _camera(label: str, world_T_camera: np.ndarray, sensor: ElementTree.Element, export: ExportFile) -> Camera:
    kind = sensor.get("type", "frame")
    if kind not in KINDS:
        raise UserError("this lens model is not supported", where=f"{export.file} {label}", expected=", ".join(KINDS),
                        found=kind[:40], remedy="export undistorted photographs")  # fmt: skip
    found = sensor.findall("calibration")
    calibration = next((one for one in found if one.get("class") == "adjusted"), found[-1] if found else None)
    resolution = sensor.find("resolution")
    if resolution is None or (calibration is None and kind != "spherical"):
        raise export.damaged("a sensor without resolution or calibration", label)

    def number(name: str) -> float:
        text = None if calibration is None else calibration.findtext(name)
        return 0.0 if text is None else float(export.numbers([text], 1, f"{name} of {label}")[0])

    size = export.numbers([resolution.get("width"), resolution.get("height")], 2, f"resolution of {label}")
    f = number("f") or number("fy")
    fx = number("fx") or f + number("b1")
    if abs(number("b2")) > MOST_SKEW * abs(f):
        raise UserError("a skewed lens is not supported", where=f"{export.file} {label}", found=f"b2 {number('b2'):g}",
                        remedy="calibrate without b2, or export undistorted photographs")  # fmt: skip
    centre = (size[0] / 2 + number("cx"), size[1] / 2 + number("cy")) if number("f") else (number("cx"), number("cy"))
    coefficients = {ours: number(theirs) for ours, theirs in METASHAPE_COEFFICIENTS.items()}
    return export.camera(label, world_T_camera, size, (fx, f), centre, Model(KINDS[kind], ()), coefficients)


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
    # where its pictures lie: one of these must be there, and the first counts
    pictures: tuple[str, ...] = ("images", ".")


def recognises(path: Path) -> bool:
    """Whether a folder holds an export of one of the programs."""
    return _found(path) is not None


def read(path: Path, options: SceneOptions) -> Scene:
    """Reads the cameras and the headers of the pictures."""
    found = _found(path)
    assert found is not None
    program, file, folder = found
    finder = FileFinder(folder, path)

    def size_of(name: str) -> tuple[int, int]:
        picture = finder.find(name)
        return UNKNOWN_SIZE if picture is None else picture_size(picture)

    return scene_of(path, program.read(file, size_of), finder, folder, 1, options)


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
    export = ExportFile("RealityCapture", file)
    lines = [line for line in file.read_text(encoding="utf-8-sig", errors="replace").splitlines() if line.strip()]
    first = next(index for index, line in enumerate(lines) if line.lower().startswith("#name"))
    separator = ";" if ";" in lines[first] else ","
    head = [column.strip().lower() for column in lines[first].split(separator)]
    if missing := [column for column in COLUMNS[:9] if column not in head]:
        raise export.damaged(f"no column {', '.join(missing)}")
    stated = next((line.split()[-1] for line in lines[:first] if line.lower().startswith("#cameras ")), None)
    listed = lines[first + 1 :]
    if stated not in (None, str(len(listed))):
        raise export.damaged(f"{len(listed)} cameras where it counts {stated}")
    cameras = {}
    for row in csv.reader(listed, delimiter=separator):
        if len(row) != len(head):
            raise export.damaged(f"{len(row)} columns where there should be {len(head)}", row[0] if row else "")
        name, values = row[0], dict(zip(head, row, strict=True))
        texts = ((column, values.get(column, "0") or "0") for column in COLUMNS)
        numbers = [export.numbers([text], 1, f"{column} of {name}")[0] for column, text in texts]
        x, y, z, heading, pitch, roll, f, px, py, *rest = numbers
        R = Rotation.from_euler("ZXY", [-heading, pitch, roll], degrees=True).as_matrix()
        width, height = size_of(name)
        scale = max(width, height) / FILM_MM
        coefficients = {key: float(value) for key, value in zip(COEFFICIENTS, rest, strict=True)}
        centre = 0.5 * width + scale * px, 0.5 * height + scale * py
        if name in cameras:
            raise export.damaged("a name that comes twice", name)
        cameras[name] = export.camera(name, np.column_stack([R, [x, y, z]]), (width, height), [scale * f], centre,
                                      coefficients=coefficients)  # fmt: skip
    return export.reconstruction(cameras)


# --- apps for phones --------------------------------------------------------------------------------------------------


def _read_polycam(first: Path, _: SizeOf) -> Reconstruction:
    """keyframes/cameras/TIME.json: t_ij of a camera-to-world matrix in OpenGL axes, and the lens in pixels."""
    cameras = {}
    for file in sorted(first.parent.glob("*.json")):
        export = ExportFile("Polycam", file)
        values = export.json(dict)
        matrix = [[export.number(values, f"t_{row}{column}") for column in range(4)] for row in range(3)]
        lens = [export.number(values, key) for key in ("width", "height", "fx", "fy", "cx", "cy")]
        cameras[file.stem] = export.camera(file.stem, matrix, lens[:2], lens[2:4], lens[4:])
    return ExportFile("Polycam", first.parent).reconstruction(cameras)


def _read_scanner_app(first: Path, size_of: SizeOf) -> Reconstruction:
    """frame_N.json of ARKit: cameraPoseARFrame, camera-to-world in OpenGL axes, and intrinsics [3, 3] in pixels."""
    cameras = {}
    for file in sorted(first.parent.glob("frame_*.json")):
        export = ExportFile("3D Scanner App", file)
        values = export.json(dict)
        matrix = export.numbers(values.get("cameraPoseARFrame"), 16, "cameraPoseARFrame").reshape(4, 4)
        K = export.numbers(values.get("intrinsics"), 9, "intrinsics").reshape(3, 3)
        # by rows or, as ARKit has them in memory, by columns
        matrix = matrix.T if np.any(matrix[3, :3]) else matrix
        K = K.T if np.any(K[2, :2]) else K
        size = size_of(file.stem)
        cameras[file.stem] = export.camera(file.stem, matrix, size, (K[0, 0], K[1, 1]), K[:2, 2])
    return ExportFile("3D Scanner App", first.parent).reconstruction(cameras)


RECORD3D_KEYS = (b'"poses"', b'"K"', b'"initPose"', b'"frameTimestamps"', b'"perFrameIntrinsicCoeffs"')


def _read_record3d(file: Path, _: SizeOf) -> Reconstruction:
    """metadata.json: poses [x, y, z, w of a quaternion, position] in OpenGL axes; K by columns, or a lens for each frame."""
    export = ExportFile("Record3D", file)
    values = export.json(dict)
    poses, lenses = export.entry(values, "poses", list), values.get("perFrameIntrinsicCoeffs")
    K = export.numbers(values.get("K"), 9, "K").reshape(3, 3).T
    size = export.number(values, "w"), export.number(values, "h")
    if lenses is not None and (not isinstance(lenses, list) or len(lenses) != len(poses)):
        raise export.damaged("perFrameIntrinsicCoeffs of another number than poses")
    cameras = {}
    for index, row in enumerate(poses):
        *turn, x, y, z = export.numbers(row, 7, f"pose {index}")
        if np.linalg.norm(turn) < 0.5:
            raise export.damaged(f"pose {index} has no rotation")
        world_T_camera = np.column_stack([Rotation.from_quat(turn).as_matrix(), [x, y, z]])
        lens = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        lens = lens if lenses is None else export.numbers(lenses[index], 4, f"lens {index}")
        cameras[f"{index}"] = export.camera(f"{index}", world_T_camera, size, lens[:2], lens[2:])
    return export.reconstruction(cameras)


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
    export = ExportFile("OpenSfM", file)
    parts = export.json(list)
    found = max(parts, key=lambda part: len(part.get("shots") or ()) if isinstance(part, dict) else 0, default={})
    shots, lenses = export.entry(found, "shots", dict), export.entry(found, "cameras", dict)
    cameras = {}
    for name, shot in shots.items():
        lens = export.entry(lenses, str(shot.get("camera")) if isinstance(shot, dict) else "camera", dict)
        rotation, t = (export.numbers(shot.get(key), 3, f"{key} of {name}") for key in ("rotation", "translation"))
        camera_T_world = np.column_stack([Rotation.from_rotvec(rotation).as_matrix(), t])
        kind = str(lens.get("projection_type"))
        if kind not in OPENSFM:
            raise UserError("this lens model is not supported", where=file, expected=", ".join(OPENSFM), found=kind[:40],
                            remedy="undistort the pictures first (opensfm undistort)")  # fmt: skip
        projection, keys = OPENSFM[kind]
        width, height = size = export.number(lens, "width"), export.number(lens, "height")
        scale, fx = max(size), export.number(lens, "focal_x", export.number(lens, "focal", 0.0))
        focal = [scale * fx, scale * export.number(lens, "focal_y", fx)]
        coefficients = {key: export.number(lens, key, 0.0) for key in keys}
        c_x, c_y = (scale * export.number(lens, key, 0.0) for key in ("c_x", "c_y"))
        middle = c_x + 0.5 * width, c_y + 0.5 * height
        world_T_camera = np.linalg.inv(pose(camera_T_world, f"{file} {name}")) @ OPENGL_FROM_OPENCV
        cameras[name] = export.camera(name, world_T_camera, size, focal, middle, Model(projection, ()), coefficients)
    points = [point if isinstance(point, dict) else {} for point in (found.get("points") or {}).values()]
    rows = [[point.get("coordinates"), point.get("color", (0, 0, 0))] for point in points]
    table = np.array([export.numbers(row, 6, "a point") for row in rows], np.float64).reshape(-1, 6)
    return export.reconstruction(cameras, table[:, :3], table[:, 3:])


# --- Bundler ----------------------------------------------------------------------------------------------------------

LISTS = ("list.txt", "bundle.list.txt", "bundle.out.list.txt")  # the pictures' names, beside the file or above


def _read_bundler(file: Path, size_of: SizeOf) -> Reconstruction:
    """bundle.out 0.3: counts; per camera f, k1, k2, R, t of camera_T_world in OpenGL axes; per point place, colour and views."""
    export = ExportFile("Bundler", file)
    names = (*LISTS, file.name + ".list.txt")
    lists = (folder / name for folder in (file.parent, file.parent.parent) for name in names)
    listing = next((found for found in lists if found.is_file()), None)
    if listing is None:
        raise export.damaged("no list.txt beside it, which names the pictures")
    lines = listing.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    names = [line.split()[0] for line in lines if line.strip()]
    words = iter(file.read_text(encoding="utf-8", errors="replace").partition("\n")[2].split())

    def take(count: int, what: str) -> np.ndarray:
        return export.numbers(list(itertools.islice(words, count)), count, what)

    def whole(what: str, most: int) -> int:
        value = take(1, what)[0]
        if not 0 <= value <= most or value != int(value):
            raise export.damaged(f"{what} {value:g}, where 0 to {most} can be")
        return int(value)

    length = file.stat().st_size
    count, points = whole("number of cameras", len(names)), whole("number of points", length)
    cameras, seen = {}, {}
    for index, name in enumerate(names[:count]):
        f, k1, k2, *rest = take(15, f"camera {index}")
        if f == 0:
            continue  # it has no pose
        camera_T_world = pose(np.column_stack([np.reshape(rest[:9], (3, 3)), rest[9:]]), f"{file} {name}")
        width, height = size = size_of(name)
        cameras[name] = export.camera(name, np.linalg.inv(camera_T_world), size, [f], (width / 2, height / 2),
                                      coefficients={"k1": float(k1), "k2": float(k2)})  # fmt: skip
        seen[name] = []
    if points * 12 > length:  # bytes that a point takes at least
        raise export.damaged(f"{points} points in {length} bytes")
    table = np.zeros((points, 6))
    for row in range(points):
        table[row] = take(6, f"point {row}")
        for view in take(4 * whole(f"views of point {row}", length), f"views of point {row}")[::4]:
            if 0 <= view < count and names[int(view)] in seen:
                seen[names[int(view)]].append(row)
    rows = {name: np.array(shown, np.int64) for name, shown in seen.items()}
    return export.reconstruction(cameras, table[:, :3], table[:, 3:], rows)


PROGRAMS = (
    Program("Metashape", ("*.xml",), lambda head: b"<document" in head and b"<chunk" in head, _read_metashape),
    Program("RealityCapture", ("*.csv",), _is_realitycapture, _read_realitycapture),
    Program("Polycam", ("keyframes/corrected_cameras/*.json",), lambda head: b'"t_00"' in head, _read_polycam,
            ("keyframes/corrected_images", ".")),
    Program("Polycam", ("keyframes/cameras/*.json",), lambda head: b'"t_00"' in head, _read_polycam, ("keyframes/images", ".")),
    Program("3D Scanner App", ("frame_*.json",), lambda head: b'"cameraPoseARFrame"' in head, _read_scanner_app, (".",)),
    Program("Record3D", ("metadata.json",), lambda head: any(key in head for key in RECORD3D_KEYS), _read_record3d,
            ("rgb", "rgbd")),
    Program("OpenSfM", ("reconstruction.json", "opensfm/reconstruction.json"), lambda head: True, _read_opensfm),
    Program("Bundler", ("bundle*.out", "bundle/bundle*.out"), lambda head: head.startswith(b"# Bundle file"), _read_bundler),
)  # fmt: skip
