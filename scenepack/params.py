"""scene_params.json: checked values out of it, and a pack's values back into it (docs/format.md).

Sizes are triples (x, y, z) = (width, height, depth). Reading keeps the whole JSON object, so that unknown
keys and the exact spelling of unchanged numbers survive a load and a save.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from console import UserError
from console.json_text import parse_json
from scenepack.constants import PLANES_PER_IMAGE, PUBLISHED_NDC_CAMERA, VIEW_MLP_WIDTHS
from scenepack.files import refuse_other_params
from scenepack.pack import Pack, ViewMlp, number_array, number_in

MAX_GRID_SIDE = 32768  # voxels
SMALLEST_VOXEL, LARGEST_VOXEL = 1e-9, 1e9  # world units, whatever these are; float32 squares such numbers
FARTHEST = 1e9  # of the grid's corner from the origin, in voxels
MAX_ATLAS_SIDE = 16384  # voxels; the largest 3D texture that any driver offers
MAX_ATLAS_BYTES = 16 << 30  # of one part, decoded
LEAST_PIXELS, MOST_PIXELS = 1e-9, 1e9  # of a photograph
AXES = ("width", "height", "depth")
LAYERS = (0, 1, 2)
INPUT_KEYS = ("input_width", "input_height", "input_focal")


def parse_params(data: bytes, where: str, note: Callable[[str], None]) -> tuple[Pack, str]:
    """The pack that the JSON text `data` describes, and the codec of its atlas.

    The atlas has its true shape, holds zeros, takes no memory and cannot be written; there are no atlas_indices yet. A view MLP
    that is all zero is left out. note(line) is called for whatever was repaired. UserError, by key, for what cannot be used.
    """
    try:
        raw = parse_json(data)
    except ValueError as error:
        raise UserError("is not JSON", where=where, found=error, remedy="copy the pack again") from error
    if not isinstance(raw, dict):
        raise UserError("is not a JSON object", where=where, expected="{…}", found=_short(raw))
    refuse_other_params(raw, where)
    return _Checker(raw, where, note).pack()


class _Checker:
    """Typed access to the raw object; every failure names the key."""

    def __init__(self, raw: dict[str, Any], where: str, note: Callable[[str], None]) -> None:
        self.raw, self.where, self.note = raw, where, note

    def wrong(self, key: str, what: str, expected: str) -> UserError:
        return UserError(f"{key} {what}", where=self.where, expected=expected, found=_short(self.raw.get(key)))

    def get(self, key: str) -> Any:
        if key not in self.raw:
            raise UserError(f"{key} is missing", where=self.where, remedy="bake or copy the pack again")
        return self.raw[key]

    def number(self, key: str, low: float, high: float, unit: str) -> float:
        if (number := number_in(self.get(key), low, high)) is None:
            raise self.wrong(key, "is out of range", f"{low:g} to {high:g} {unit}")
        return number

    def whole(self, key: str, most: int) -> int:
        if (number := number_in(self.get(key), 1, most)) is None or number != int(number):
            raise self.wrong(key, "is out of range", f"a whole number from 1 to {most}")
        return int(number)

    def array(self, key: str, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        value = self.get(key)
        array = number_array(value, dtype)
        if array is None or array.shape != shape:
            found = _short(value) if array is None else _sides(array.shape)
            expected = f"{_sides(shape)} numbers"
            raise UserError(f"{key} has the wrong shape", where=self.where, expected=expected, found=found)
        if bad := int(np.sum(~np.isfinite(array))):
            raise UserError(f"{key} holds {bad} values that are NaN or infinite", where=self.where)
        return array

    def pack(self) -> tuple[Pack, str]:
        voxel_size = self.number("voxel_size", SMALLEST_VOXEL, LARGEST_VOXEL, "world units")
        far = FARTHEST * voxel_size
        block_size = self.whole("block_size", 1024)
        x, y, z = (self.whole(f"grid_{axis}", MAX_GRID_SIDE) for axis in AXES)
        width, height, depth = (self.whole(f"atlas_{axis}", MAX_ATLAS_SIDE) for axis in AXES)
        if width * height * depth * 4 > MAX_ATLAS_BYTES:
            what = f"an atlas of {width} × {height} × {depth} voxels is too large"
            raise UserError(what, where=self.where, expected=f"at most {MAX_ATLAS_BYTES >> 30} GiB")
        if self.get("ndc") not in (0, 1):
            raise self.wrong("ndc", "is neither true nor false", "true or false")
        ndc = bool(self.raw["ndc"])
        input_width, input_height, input_focal = self.input_camera(ndc)
        nothing = np.broadcast_to(np.uint8(0), (depth, height, width, 4))
        pack = Pack(
            voxel_size=voxel_size, min_xyz=np.array([self.number(f"min_{axis}", -far, far, "world units") for axis in "xyz"]),
            grid_size=(x, y, z), block_size=block_size, atlas_indices=np.zeros((0, 0, 0, 3), np.uint8), atlas_rgba=nothing,
            atlas_features=nothing, view_mlp=self.view_mlp(), worldspace_T_opengl=self.frame(), ndc=ndc,
            input_width=input_width, input_height=input_height, input_focal=input_focal, params=self.raw,
        )  # fmt: skip
        return pack, self.format()

    def frame(self) -> np.ndarray:
        matrix = self.array("worldspace_T_opengl", (4, 4), np.float64)
        with np.errstate(all="ignore"):  # of the smallest and the largest numbers that there are
            # Relative to the lengths of its rows, so that a scaled frame is not taken for a singular one.
            lengths = np.linalg.norm(matrix[:3, :3], axis=1)
            is_regular = abs(np.linalg.det(matrix[:3, :3])) > 1e-9 * np.prod(lengths) and matrix[3, 3] != 0
        if not is_regular or np.max(np.abs(matrix)) > LARGEST_VOXEL:
            expected = f"a rotation, 4×4, of numbers up to {LARGEST_VOXEL:g}"
            raise UserError("worldspace_T_opengl is no frame", where=self.where, expected=expected)
        return matrix

    def format(self) -> str:
        if "format" not in self.raw:
            self.note(f"{self.where}: format is missing; taken as png")
        if not isinstance(value := self.raw.get("format", "png"), str):
            raise self.wrong("format", "is not a name", "png")
        return value

    def input_camera(self, ndc: bool) -> tuple[float | None, float | None, float | None]:
        """Width, height and focal length of the training photographs, None where absent."""
        if ndc and self.raw.get("input_focal") is None:
            # Older forward-facing packs; the published viewer then ignores the other two as well.
            self.note(f"{self.where}: input_focal is missing; the published viewer's camera is used")
            return PUBLISHED_NDC_CAMERA
        width, height, focal = (_pixels(self.raw.get(key)) for key in INPUT_KEYS)
        for key, pixels in zip(INPUT_KEYS, (width, height, focal), strict=True):
            if pixels is None and ndc:
                what = "is missing" if self.raw.get(key) is None else "is not a size"
                raise self.wrong(key, what, "pixels, above 0, as the pack is ndc")
            if pixels is None and self.raw.get(key) is not None:
                self.note(f"{self.where}: {key} is {_short(self.raw[key])}; ignored")
        return width, height, focal

    def view_mlp(self) -> ViewMlp | None:
        if not any(f"{layer}_bias" in self.raw for layer in LAYERS):
            return None
        shapes = [(VIEW_MLP_WIDTHS[layer], VIEW_MLP_WIDTHS[layer + 1]) for layer in LAYERS]
        w0, w1, w2 = (self.array(f"{layer}_weights", shapes[layer], np.float32) for layer in LAYERS)
        b0, b1, b2 = (self.array(f"{layer}_bias", shapes[layer][1:], np.float32) for layer in LAYERS)
        if not any(map(np.any, (w0, w1, w2, b0, b1, b2))):  # which is meant as diffuse
            self.note(f"{self.where}: the view MLP is all zero; the pack is shown as diffuse")
            return None
        return ViewMlp((w0, w1, w2), (b0, b1, b2))


def _pixels(value: Any) -> float | None:
    """A size of a picture, which may be written as text; None for anything else."""
    try:
        return number_in(float(value) if isinstance(value, str) else value, LEAST_PIXELS, MOST_PIXELS)
    except ValueError:
        return None


def _sides(shape: tuple[int, ...]) -> str:
    return "".join(f"[{n}]" for n in shape)


def _short(value: object) -> str:
    text = "an object" if isinstance(value, dict) else "a list" if isinstance(value, list) else repr(value)
    return text if len(text) <= 40 else text[:37] + "…"


def params_json(pack: Pack, format: str, metadata: Mapping[str, Any]) -> dict[str, Any]:
    """scene_params.json for `pack`: what it was read from, with every value that has changed since.

    A value that still reads back as the pack's field keeps its place and spelling, and so does the view MLP of a pack that is
    shown as diffuse; `metadata` goes under "snerg".
    """
    raw = dict(pack.params)
    depth, height, width = pack.atlas_rgba.shape[:3]
    values: dict[str, Any] = {"voxel_size": float(pack.voxel_size), "block_size": int(pack.block_size)}
    values |= {f"grid_{axis}": int(n) for axis, n in zip(AXES, pack.grid_size, strict=True)}
    values |= {"atlas_width": width, "atlas_height": height, "atlas_depth": depth}
    values["num_slices"] = -(-depth // PLANES_PER_IMAGE)
    values |= {f"min_{axis}": float(n) for axis, n in zip("xyz", pack.min_xyz, strict=True)}
    values |= {f"atlas_blocks_{axis}": n for axis, n in zip("xyz", pack.atlas_blocks, strict=True)}
    camera = (pack.input_width, pack.input_height, pack.input_focal)
    if not pack.ndc or raw.get("input_focal") is not None or camera != PUBLISHED_NDC_CAMERA:  # else it was assumed
        known = zip(INPUT_KEYS, camera, strict=True)
        values |= {key: float(value) for key, value in known if value is not None and _pixels(raw.get(key)) != value}
    values["worldspace_T_opengl"] = pack.worldspace_T_opengl.tolist()
    values["ndc"] = bool(pack.ndc)
    values["format"] = format
    if pack.view_mlp is not None:
        for layer in LAYERS:
            values[f"{layer}_weights"] = pack.view_mlp.weights[layer]
            values[f"{layer}_bias"] = pack.view_mlp.biases[layer]
    if metadata:
        values["snerg"] = dict(metadata)
    for key, value in values.items():
        if key not in raw or not _same(raw[key], value):
            raw[key] = value.tolist() if isinstance(value, np.ndarray) else value
    return raw


def _same(old: Any, new: Any) -> bool:
    """Whether `old`, from JSON, reads back as `new`; weights are compared as the float32 that they are."""
    if isinstance(new, np.ndarray):
        array = number_array(old, new.dtype.type)
        return array is not None and np.array_equal(array, new)
    return type(old) is type(new) and old == new if isinstance(new, bool) else old == new
