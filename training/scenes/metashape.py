"""Agisoft Metashape's cameras.xml: sensors, cameras, and the transforms of chunks and components.

Notation: a camera's transform is chunk_T_camera, OpenCV axes. Metashape's lens model: k1 … k4 as everywhere, its p1, p2 are
OpenCV's p2, p1; fx = f + b1; cx and cy count from the middle of the picture (Metashape's manual, "Camera models").
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from console import UserError
from training.scenes.colmap_files import OPENGL_FROM_OPENCV, Reconstruction
from training.scenes.export_file import ExportFile
from training.scenes.lens import EQUIRECTANGULAR, FISHEYE, PERSPECTIVE, Model
from training.scenes.scene import Camera

MOST_BYTES = 256 << 20
MOST_SKEW = 1e-3  # b2, of the focal length: no lens here is skewed
KINDS = {"frame": PERSPECTIVE, "fisheye": FISHEYE, "spherical": EQUIRECTANGULAR}
COEFFICIENTS = {"k1": "k1", "k2": "k2", "k3": "k3", "k4": "k4", "p1": "p2", "p2": "p1"}  # by our names: theirs


def is_metashape(head: bytes) -> bool:
    """Whether the first bytes of an XML file are those of a document of Metashape."""
    return b"<document" in head and b"<chunk" in head


def read_metashape(file: Path, _: object) -> Reconstruction:
    """The cameras that have a pose, by label. UserError for anything else."""
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
            world_T_chunk = parts.get(camera.get("component_id"))
            world_T_chunk = whole if world_T_chunk is None else world_T_chunk
            world_T_camera = (
                (np.eye(4) if world_T_chunk is None else world_T_chunk) @ chunk_T_camera @ OPENGL_FROM_OPENCV
            )
            cameras[label] = _camera(label, world_T_camera, sensor, export)
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
    found = element.find("transform")
    if found is None:
        return None
    R, t, s = (found.findtext(name) for name in ("rotation", "translation", "scale"))
    matrix = np.eye(4)
    if R is not None:
        matrix[:3, :3] = export.numbers(R.split(), 9, "rotation of a chunk").reshape(3, 3)
    if s is not None:
        matrix[:3, :3] *= export.numbers([s], 1, "scale of a chunk")
    if t is not None:
        matrix[:3, 3] = export.numbers(t.split(), 3, "translation of a chunk")
    return matrix


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
    coefficients = {ours: number(theirs) for ours, theirs in COEFFICIENTS.items()}
    return export.camera(label, world_T_camera, size, (fx, f), centre, Model(KINDS[kind], ()), coefficients)
