"""Scenes that mean the same and are written otherwise: in either layout of transforms, or COLMAP's, with names, keys, orders
and numbers as programs on other systems write them. All must have the same rays, to 1e-5; tests/fuzz/test_fuzz.py tries some.
"""

import json
import unicodedata
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
from PIL import Image

from tools.pose_error import similarity
from training.scenes import load_scene
from training.scenes.poses import look_at
from training.scenes.scene import Camera, Scene, camera_rays

SIZE = (12, 9)
PIXELS = np.array([0.5, 6.0, 11.5]), np.array([0.5, 8.5, 4.0])
NAMES = ("photo_{:03d}", "Été {:02d}", "r_0.{:d}", "IMG_{:04d}", "Straße {:d}")
TOLERANCE = 1e-5


def true_cameras(random: Random) -> list[Camera]:
    """Some cameras around a point somewhere, with one lens or several."""
    rng = np.random.default_rng(random.randrange(1 << 30))
    scale, centre = 10.0 ** rng.uniform(-1, 1), rng.uniform(-5, 5, 3)
    shared = _lens(rng)
    cameras = []
    for index in range(random.randint(4, 9)):
        angle = 0.7 * index + rng.uniform(-0.1, 0.1)
        eye = scale * np.array([np.cos(angle), np.sin(angle), rng.uniform(0.2, 0.6)])
        back = eye / np.linalg.norm(eye) + rng.normal(size=3) * 0.02
        pose = look_at(eye + centre, back, np.array([0.0, 0.0, 1.0]))
        lens = shared if random.random() < 0.7 else _lens(rng)
        cameras.append(Camera(pose, *SIZE, *lens[:4], tuple(lens[4:])))  # type: ignore[arg-type]
    return cameras


def _lens(rng: np.random.Generator) -> list[float]:
    fx = rng.uniform(10, 20)
    distortion = rng.uniform(-0.05, 0.05, 4) * [1, 0.5, 0.05, 0.05] * (rng.random() < 0.6)
    return [fx, fx * rng.uniform(0.98, 1.02), rng.uniform(5, 7), rng.uniform(4, 5), *distortion]


def write_scene(folder: Path, cameras: list[Camera], random: Random) -> list[str]:
    """One way to write the cameras; returns their names as the disk has them, without suffix."""
    pattern = random.choice(NAMES)
    stems = [unicodedata.normalize("NFC", pattern.format(index)) for index in range(len(cameras))]
    suffix = random.choice([".png", ".PNG", ".bmp", ".jpg", ".JPG", ".webp", ".tif"])
    write = random.choice([_write_blender, _write_capture, _write_capture, _write_colmap])
    write(folder, cameras, stems, suffix, random)
    if random.random() < 0.3:
        for picture in [*folder.rglob(f"*{suffix}")]:
            (picture.parent / f"._{picture.name}").write_bytes(b"\0\5\26\7")  # as macOS leaves beside files
    return stems


def _stored(folder: Path, name: str, suffix: str, random: Random) -> None:
    """The picture, its name composed or decomposed."""
    picture = folder / (unicodedata.normalize(random.choice(["NFC", "NFD"]), name) + suffix)
    picture.parent.mkdir(parents=True, exist_ok=True)
    kind = {".jpg": "JPEG", ".tif": "TIFF"}.get(suffix.lower(), suffix[1:].upper())
    Image.new("RGB", SIZE, (90, 60, 30)).save(picture, format=kind)


def _spelled(name: str, suffix: str, random: Random) -> str:
    ends = [suffix, suffix, "", suffix.lower(), suffix.upper(), ".jpg", ".png"]
    text = name + random.choice(ends)
    changes: list[Callable[[str], str]] = [
        lambda t: t, lambda t: f"./{t}", lambda t: t.replace("/", "\\"), lambda t: t.replace("/", "//"), str.upper,
        lambda t: f"C:\\work\\scene\\{t}", lambda t: f"/mnt/capture/{t}", lambda t: unicodedata.normalize("NFD", t),
    ]  # fmt: skip
    for _ in range(random.randint(0, 2)):
        text = random.choice(changes)(text)
    return text


def _camera_keys(camera: Camera, random: Random) -> dict[str, object]:
    """One way to say the same lens."""
    factor = random.choice([1, 2, 4])  # pictures stored smaller than the description has them
    keys: dict[str, object] = {"w": SIZE[0] * factor, "h": SIZE[1] * factor}
    keys |= {"cx": camera.cx * factor, "cy": camera.cy * factor}
    keys |= dict(zip(("k1", "k2", "p1", "p2"), camera.distortion, strict=True))
    how = random.randrange(3)
    if how == 0:
        keys |= {"fl_x": camera.fx * factor, "fl_y": camera.fy * factor}
        if random.random() < 0.5:
            keys["camera_angle_x"] = 0.5  # which converters write of another side; lengths win
    else:
        angles = [2 * np.arctan(side / 2 / focal) for side, focal in zip(SIZE, (camera.fx, camera.fy), strict=True)]
        names = ("camera_angle_x", "camera_angle_y") if how == 1 else ("x_fov", "y_fov")
        keys |= dict(zip(names, angles if how == 1 else np.degrees(angles).tolist(), strict=True))
    if random.random() < 0.5:
        keys["camera_model"] = random.choice(["OPENCV", "opencv", "", None])
    if random.random() < 0.3:
        keys |= {"k3": 0.0, "k4": 0, "is_fisheye": False, "sharpness": 12.3, "rolling_shutter": [0, 0, 0]}
    return keys


def _dump(file: Path, document: dict[str, object], random: Random) -> None:
    items = list(document.items())
    random.shuffle(items)
    text = json.dumps(dict(items), ensure_ascii=random.random() < 0.5, indent=random.choice([None, 1]))
    file.write_bytes(random.choice([b"", b"\xef\xbb\xbf"]) + text.replace("\n", random.choice(["\n", "\r\n"])).encode())


def _frames(cameras: list[Camera], names: list[str], suffix: str, random: Random) -> dict[str, object]:
    """Frames in any order, with the lens at the top where all share it."""
    frames = []
    top = _camera_keys(cameras[0], random)
    lenses = {(c.fx, c.fy, c.cx, c.cy, c.distortion) for c in cameras}
    shared = len(lenses) == 1 and random.random() < 0.7
    for camera, name in zip(cameras, names, strict=True):
        matrix = camera.world_T_camera if random.random() < 0.7 else camera.world_T_camera[:3]
        frame: dict[str, object] = {"file_path": _spelled(name, suffix, random), "transform_matrix": matrix.tolist()}
        frames.append(frame if shared else frame | _camera_keys(camera, random))
    random.shuffle(frames)
    return {**(top if shared or random.random() < 0.3 else {}), "frames": frames}


def _write_blender(folder: Path, cameras: list[Camera], stems: list[str], suffix: str, random: Random) -> None:
    held_out = random.randint(0, 2)
    split = len(cameras) - held_out
    for name, some, theirs in (("train", cameras[:split], stems[:split]), ("test", cameras[split:], stems[split:])):
        for stem in theirs:
            _stored(folder / name, stem, suffix, random)
        if some:
            frames = _frames(some, [f"{name}/{stem}" for stem in theirs], suffix, random)
            _dump(folder / f"transforms_{name}.json", frames, random)


def _write_capture(folder: Path, cameras: list[Camera], stems: list[str], suffix: str, random: Random) -> None:
    place = random.choice(["images", "", "Images/left"])
    for stem in stems:
        _stored(folder / place, stem, suffix, random)
    document = _frames(cameras, [f"{place}/{stem}".lstrip("/") for stem in stems], suffix, random)
    if random.random() < 0.5:
        document["aabb_scale"] = random.choice([1, 4, 16, 128])
    _dump(folder / "transforms.json", document, random)


def _write_colmap(folder: Path, cameras: list[Camera], stems: list[str], suffix: str, random: Random) -> None:
    from scipy.spatial.transform import Rotation

    place = folder / "sparse" / random.choice(["0", "1", "."])
    place.mkdir(parents=True, exist_ok=True)
    lenses, images = [], []
    for index, (camera, stem) in enumerate(zip(cameras, stems, strict=True)):
        _stored(folder / "images", stem, suffix, random)
        values = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
        lenses.append(f"{index} OPENCV {SIZE[0]} {SIZE[1]} " + " ".join(map(repr, map(float, values))))
        inverse = np.linalg.inv(camera.world_T_camera @ np.diag([1.0, -1.0, -1.0, 1.0]))
        x, y, z, w = Rotation.from_matrix(inverse[:3, :3]).as_quat()
        numbers = " ".join(repr(float(value)) for value in (w, x, y, z, *inverse[:3, 3]))
        images += [f"{index} {numbers} {index} {_spelled(f'images/{stem}', suffix, random)}", ""]
    pairs = list(zip(images[::2], images[1::2], strict=True))
    random.shuffle(pairs)
    mark, end = random.choice([b"", b"\xef\xbb\xbf"]), random.choice(["\n", "\r\n"])
    for file, lines in (("cameras", lenses), ("images", [line for pair in pairs for line in pair])):
        (place / f"{file}.txt").write_bytes(mark + ("# written by a test" + end + end.join(lines) + end).encode())
    if random.random() < 0.5:
        (place / "points3D.txt").write_bytes(mark)


def differs(scene: Scene, cameras: list[Camera], stems: list[str]) -> str:
    """How rays of a scene differ from those of the cameras, up to one similarity of space; "" where they do not."""
    found = {}
    for photograph in (each for split in scene.splits.values() for each in split):
        path: Path = photograph.load.path  # type: ignore[attr-defined]
        found[unicodedata.normalize("NFC", path.stem)] = photograph.camera
    if sorted(found) != sorted(stems):
        return f"photographs {sorted(found)}"
    ours = [found[stem] for stem in stems]
    P, Q = (np.stack([camera.world_T_camera for camera in each]) for each in (cameras, ours))
    scale, turn, offset = similarity(P[:, :3, 3], Q[:, :3, 3])
    error = float(np.abs(scale * P[:, :3, 3] @ turn.T + offset - Q[:, :3, 3]).max() / np.ptp(Q[:, :3, 3]))
    for camera, other in zip(cameras, ours, strict=True):
        mine, theirs = (camera_rays(each, *PIXELS)[1] for each in (camera, other))
        error = max(error, float(np.abs(theirs - mine @ turn.T).max()))
    return "" if error < TOLERANCE else f"rays by {error:.2g}"


def trial(seed: int, folder: Path) -> str:
    """Writes scene number `seed` and reads it; what is wrong, or ""."""
    random = Random(seed)
    cameras = true_cameras(random)
    stems = write_scene(folder, cameras, random)
    with warnings.catch_warnings(action="ignore"):
        return differs(load_scene(folder), cameras, stems)
