"""Exports of other programs: known cameras are read to 1e-4, points are found where they were seen, damage is one line."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.training.reconstructions import FLIP, ball
from tests.training.test_captures import circle, complaint, everyone
from tools.pose_error import similarity
from training.scenes import load_scene
from training.scenes.programs import PROGRAMS
from training.scenes.scene import pixels_of

WIDE, HIGH, FOCAL, CX, CY = 60, 40, 55.0, 31.0, 18.5
K1, K2, P1, P2 = 0.05, -0.02, 0.003, -0.002
POSES = circle(12)
POINTS = ball(120)
TURN = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()  # of a chunk


def pictures(folder: Path, names: Any = None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(len(POSES)):
        Image.new("RGB", (WIDE, HIGH), (10 * i, 90, 50)).save(folder / (names(i) if names else f"IMG_{i:03d}.jpg"))


def metashape(path: Path) -> None:
    pictures(path / "images")
    values = {"f": FOCAL, "cx": CX - WIDE / 2, "cy": CY - HIGH / 2, "k1": K1, "k2": K2, "p1": P2, "p2": P1}
    calibration = "".join(f"<{name}>{value}</{name}>" for name, value in values.items())
    sensors = "".join(
        f'<sensor id="{i}" type="frame"><resolution width="{WIDE}" height="{HIGH}"/><calibration class="initial"><f>9</f>'
        f'</calibration><calibration type="frame" class="adjusted">{calibration}</calibration></sensor>' for i in range(2)
    )  # fmt: skip
    chunk_T_world = np.eye(4)
    chunk_T_world[:3, :3], chunk_T_world[:3, 3] = TURN.T / 2.5, -TURN.T @ [1.0, 2.0, 3.0] / 2.5
    cameras = ""
    for i, P in enumerate(POSES):
        T = chunk_T_world @ P @ FLIP
        T[:3, :3] *= 2.5  # a camera's own axes have unit length in its chunk
        numbers = " ".join(map(repr, T.ravel().tolist()))
        cameras += f'<camera id="{i}" sensor_id="{i % 2}" label="IMG_{i:03d}"><transform>{numbers}</transform></camera>'
    chunk = f"<rotation>{' '.join(map(repr, TURN.ravel().tolist()))}</rotation><translation>1 2 3</translation><scale>2.5</scale>"
    (path / "cameras.xml").write_text(
        f'<?xml version="1.0" encoding="UTF-8"?><document version="2.0.0"><chunk label="Chunk 1"><sensors>{sensors}</sensors>'
        f'<cameras>{cameras}<camera id="99" sensor_id="0" label="lost"/></cameras><transform>{chunk}</transform></chunk>'
        "</document>"
    )


def realitycapture(path: Path) -> None:
    pictures(path / "images")
    mm = 36 / WIDE
    lines = ["#cameras 12", "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"]
    for i, P in enumerate(POSES):
        heading, pitch, roll = Rotation.from_matrix(P[:3, :3]).as_euler("ZXY", degrees=True)
        lens = [FOCAL * mm, (CX - WIDE / 2) * mm, (CY - HIGH / 2) * mm, K1, K2, 0, 0, P1, P2]
        numbers = [*P[:3, 3], -heading, pitch, roll, *lens]
        lines.append(",".join([f"IMG_{i:03d}.jpg", *(repr(float(n)) for n in numbers)]))
    (path / "cameras.csv").write_text("\n".join(lines) + "\n")


def polycam(path: Path) -> None:
    pictures(path / "keyframes/images", lambda i: f"{1000 + i}.jpg")
    (path / "keyframes/cameras").mkdir()
    for i, P in enumerate(POSES):
        values = {f"t_{row}{column}": P[row, column] for row in range(3) for column in range(4)}
        values |= {"fx": FOCAL, "fy": FOCAL, "cx": CX, "cy": CY, "width": WIDE, "height": HIGH, "blur_score": 1.0}
        (path / f"keyframes/cameras/{1000 + i}.json").write_text(json.dumps(values))


def scanner_app(path: Path) -> None:
    pictures(path, lambda i: f"frame_{i:05d}.jpg")
    for i, P in enumerate(POSES):
        K = [FOCAL, 0, CX, 0, FOCAL, CY, 0, 0, 1]
        values = {"cameraPoseARFrame": P.ravel().tolist(), "intrinsics": K, "frame_index": i}
        (path / f"frame_{i:05d}.json").write_text(json.dumps(values))


def record3d(path: Path) -> None:
    pictures(path / "rgb", lambda i: f"{i}.jpg")
    poses = [[*Rotation.from_matrix(P[:3, :3]).as_quat().tolist(), *P[:3, 3].tolist()] for P in POSES]
    values = {"poses": poses, "K": [FOCAL, 0, 0, 0, FOCAL, 0, CX, CY, 1], "w": WIDE, "h": HIGH, "fps": 30}
    (path / "metadata.json").write_text(json.dumps(values))


def opensfm(path: Path) -> None:
    pictures(path / "images")
    lens = {"projection_type": "brown", "width": WIDE, "height": HIGH, "focal_x": FOCAL / WIDE, "focal_y": FOCAL / WIDE}
    lens |= {"c_x": (CX - WIDE / 2) / WIDE, "c_y": (CY - HIGH / 2) / WIDE}
    lens |= {"k1": K1, "k2": K2, "k3": 0, "p1": P1, "p2": P2}
    shots = {}
    for i, P in enumerate(POSES):
        T = np.linalg.inv(P @ FLIP)
        shots[f"IMG_{i:03d}.jpg"] = {"rotation": Rotation.from_matrix(T[:3, :3]).as_rotvec().tolist(), "camera": "v2 x",
                                     "translation": T[:3, 3].tolist()}  # fmt: skip
    points = {str(i): {"coordinates": p.tolist(), "color": [1.0, 2.0, 3.0]} for i, p in enumerate(POINTS)}
    (path / "opensfm").mkdir()
    parts = [{"cameras": {"v2 x": lens}, "shots": shots, "points": points}, {"cameras": {}, "shots": {}}]
    (path / "opensfm/reconstruction.json").write_text(json.dumps(parts))


def bundler(path: Path) -> None:
    pictures(path / "images")
    lines = ["# Bundle file v0.3", f"{len(POSES) + 1} {len(POINTS)}"]
    for P in POSES:
        T = np.linalg.inv(P)
        lines += [f"{FOCAL} {K1} {K2}", *(" ".join(map(repr, row.tolist())) for row in (*T[:3, :3], T[:3, 3]))]
    lines += ["0 0 0", *["0 0 0"] * 4]  # a picture without a pose
    for point in POINTS:
        lines += [" ".join(map(repr, point.tolist())), "9 8 7", f"2 0 5 1.0 2.0 {len(POSES)} 3 1.0 1.0"]
    (path / "bundle.out").write_text("\n".join(lines) + "\n")
    names = [f"images/IMG_{i:03d}.jpg 0 {FOCAL}" for i in range(len(POSES))] + ["images/lost.jpg"]
    (path / "list.txt").write_text("\n".join(names) + "\n")


WRITERS: dict[str, Callable[[Path], None]] = {
    "Metashape": metashape, "RealityCapture": realitycapture, "Polycam": polycam, "3D Scanner App": scanner_app,
    "Record3D": record3d, "OpenSfM": opensfm, "Bundler": bundler,
}  # fmt: skip
DISTORTED = ("Metashape", "RealityCapture", "OpenSfM")
assert set(WRITERS) == {program.name for program in PROGRAMS}


def expected_pixels(P: np.ndarray, name: str) -> np.ndarray:
    """Where a camera shows POINTS, by hand: OpenCV's model."""
    x, y, z = ((POINTS - P[:3, 3]) @ P[:3, :3] @ FLIP[:3, :3]).T
    a, b = x / z, y / z
    k1, k2, p1, p2 = (K1, K2, P1, P2) if name in DISTORTED else (K1, K2, 0, 0) if name == "Bundler" else (0, 0, 0, 0)
    cx, cy = (WIDE / 2, HIGH / 2) if name == "Bundler" else (CX, CY)
    r2 = a * a + b * b
    radial = 1 + k1 * r2 + k2 * r2 * r2
    u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    v = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
    return np.stack([cx + FOCAL * u, cy + FOCAL * v], -1)


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.filterwarnings("ignore")
def test_known_points_are_seen_where_the_export_says(tmp_path: Path, name: str):
    WRITERS[name](tmp_path)
    scene = load_scene(tmp_path)
    assert scene.kind == "program" and len(scene.splits["train"]) == 10 and len(scene.splits["test"]) == 2
    photographs = sorted(everyone(scene), key=lambda p: (len(p.name), p.name))
    eyes = np.stack([p.camera.world_T_camera[:3, 3] for p in photographs])
    scale, R, offset = similarity(POSES[:, :3, 3], eyes)
    for photograph, P in zip(photographs, POSES, strict=True):
        pixels, _ = pixels_of(photograph.camera, scale * POINTS @ R.T + offset)
        np.testing.assert_allclose(pixels, expected_pixels(P, name), atol=1e-4)
    assert photographs[0].load().shape == (HIGH, WIDE, 4)


def exported(path: Path) -> list[Path]:
    """The files of an export that are no pictures."""
    return sorted(file for file in path.rglob("*") if file.suffix in (".xml", ".csv", ".json", ".out", ".txt"))


def spoilt(text: str) -> list[str]:
    """Ways in which a file arrives broken."""
    middle = len(text) // 2
    digits = [i for i, c in enumerate(text) if c.isdigit() and i > 0.4 * len(text)]
    at = digits[len(digits) // 2]
    cut = [text[: len(text) // 3], text[:-20], text[: middle - len(text) // 20] + text[middle:]]
    changed = [text[:at] + word + text[at + 1 :] for word in ("nan", "1e999", "wide")]
    inserted = [text[:at] + word + text[at:] for word in ("\x01{<", " ")]
    return [*cut, *changed, *inserted, text.replace(str(FOCAL)[:2], "-55")]


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.filterwarnings("ignore")
def test_what_arrives_broken_is_refused_in_one_line(tmp_path: Path, name: str):
    WRITERS[name](tmp_path)
    file = max(exported(tmp_path), key=lambda f: f.stat().st_size)
    whole = file.read_text()
    for broken in spoilt(whole):
        if broken != whole:
            file.write_text(broken)
            line = complaint(tmp_path)
            assert file.name in line or file.parent.name in line, broken[:500]


@pytest.mark.parametrize("name", ["cameras.XML", "cameras.CSV"])
def test_the_suffix_of_an_export_may_be_in_capitals(tmp_path: Path, name: str):
    WRITERS["Metashape" if name.endswith("XML") else "RealityCapture"](tmp_path)
    (tmp_path / name.lower()).rename(tmp_path / name)
    assert load_scene(tmp_path).kind == "program"


@pytest.mark.parametrize(
    ("name", "edit", "words"),
    [
        ("Metashape", ('type="frame"><res', 'type="rpc"><res'), "rpc"),
        ("Metashape", ('<?xml version="1.0" encoding="UTF-8"?>', '<!DOCTYPE a [<!ENTITY b "c">]>'), "a document type"),
        ("Metashape", ("<k1>", "<b2>9</b2><k1>"), "skewed"),
        ("Metashape", ('sensor_id="1"', 'sensor_id="7"'), "sensor"),
        ("Metashape", ('label="IMG_001"', 'label="IMG_002"'), "twice"),
        ("RealityCapture", (",roll,", ",rolled,"), "no column roll"),
        ("OpenSfM", ('"brown"', '"dual"'), "dual"),
        ("OpenSfM", ('"v2 x": {', '"v2 y": {'), "no v2 x"),
        ("Bundler", ("13 120", "130 120"), "number of cameras"),
        ("Bundler", ("13 120", "13 99999999"), "number of points"),
    ],
)
def test_what_is_wrong_with_an_export_is_named(tmp_path: Path, name: str, edit: tuple[str, str], words: str):
    WRITERS[name](tmp_path)
    file = max(exported(tmp_path), key=lambda f: f.stat().st_size)
    text = file.read_text()
    assert edit[0] in text
    file.write_text(text.replace(*edit))
    assert words in complaint(tmp_path)
