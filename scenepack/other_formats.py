"""Scenes of other programs, by name, for the refusal of what is no pack."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from console import UserError

REMEDY = "snerg opens SNeRG packs; make one of the photographs: snerg-make PHOTOS --out DIR"
HEADER_BYTES = 8192  # of a .ply, in which its properties are listed
# What tells by a key of scene_params.json that it is no pack of ours; the first that is there counts.
_KEYS = (
    ("num_local_submodels", "a SMERF pack"),
    ("sm_to_params", "a SMERF pack"),
    ("submodel_idx", "a SMERF pack"),
    ("triplane_resolution", "a MERF pack"),
    ("triplane_voxel_size", "a MERF pack"),
    ("sparse_grid_resolution", "a binary opacity grid"),
)
_GAUSSIANS = "a file of 3D Gaussians"
_SUFFIXES = {
    ".splat": _GAUSSIANS,
    ".ksplat": _GAUSSIANS,
    ".spz": _GAUSSIANS,
    ".sog": _GAUSSIANS,
    ".ingp": "a snapshot of instant-ngp",
    ".msgpack": "a snapshot of instant-ngp",
    ".ckpt": "a checkpoint of another program",
    ".pth": "a checkpoint of another program",
    ".obj": "a mesh",
    ".glb": "a mesh",
    ".gltf": "a mesh",
    ".stl": "a mesh",
}
_PLANES = ("plane_features_", "plane_rgb_and_density_", "plane_density_")  # pictures of a MERF pack


def refuse_other_params(raw: Mapping[str, Any], where: str) -> None:
    """UserError where a scene_params.json is another program's."""
    for key, name in _KEYS:
        if key in raw:
            raise UserError(f"this is {name}", where=where, found=key, remedy=REMEDY)


def refuse_other_file(path: Path) -> None:
    """UserError where the file is another program's scene. OSError where it cannot be read."""
    suffix = path.suffix.lower()
    name = _SUFFIXES.get(suffix)
    with open(path, "rb") as file:
        head = file.read(HEADER_BYTES)
    if head.startswith((b"ply\n", b"ply\r")):
        header = head.partition(b"end_header")[0]
        kind = (
            _GAUSSIANS
            if b" f_dc_0" in header or b" rot_0" in header
            else "a mesh"
            if b"element face" in header
            else None
        )
        name = kind or "a cloud of points"
        suffix = ".ply"
    elif head.startswith(b"PK") and suffix not in (".sog",):
        name = None  # a .zip under another name
    if name is not None:
        raise UserError(f"this is {name} ({suffix})", where=path, remedy=REMEDY)


def refuse_other_names(path: Path, names: Iterable[str]) -> None:
    """UserError where the names of the files in a folder or .zip tell that it is another program's scene."""
    names = sorted(names)
    for name in names:
        if name.startswith(_PLANES):
            raise UserError("this is a MERF pack", where=path, found=name, remedy=REMEDY)
        if (kind := _SUFFIXES.get(Path(name).suffix.lower())) == _GAUSSIANS:
            raise UserError(f"this holds {kind}", where=path, found=name, remedy=REMEDY)
