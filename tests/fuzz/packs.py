"""Packs: what is spoilt, and all that opening one does short of drawing it."""

import io
from pathlib import Path

import numpy as np
from PIL import Image
from rich.console import Console

from scenepack import save_pack
from scenepack.cameras import picture_uri
from scenepack.check import check_pack
from scenepack.reader import open_pack
from scenepack.report import pack_facts, print_facts, print_findings
from tests.fuzz.words import require_words
from tests.scenepack.helpers import small_pack
from viewer.core.files import kind_of, pack_in
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.camera.orbit_camera import view_from_within
from viewer.features.photographs.photographs import Photographs
from viewer.rendering.skip_grid import skip_grid_of

CODECS = ("png", "jpeg", "webp", "avif", "h264")
BASES = (*CODECS, "forward-facing", "diffuse")
PICTURES = 2  # of a pack's own copies of photographs that are decoded


def write_base(name: str, folder: Path) -> None:
    """A valid pack of about 100 KB decoded, with cameras, copies of their photographs and a provenance."""
    pack = small_pack(ndc=name == "forward-facing", diffuse=name == "diffuse")
    picture = picture_uri(np.asarray(Image.effect_noise((8, 8), 90).convert("RGB")), 8)
    cameras = [
        {"name": f"train/r_{i}", "split": "train" if i else "test", "world_T_camera": np.eye(4).tolist(), "width": 8, "height": 8,
         "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 4.0, "picture": picture}
        for i in range(3)
    ]  # fmt: skip
    pack = pack.with_metadata(cameras=cameras, provenance={"scene": "/nowhere", "steps": 3, "spherify": False})
    codec = name if name in CODECS else "png"
    save_pack(pack, folder, codec=codec)


def open_it(path: Path, base: str) -> None:
    """Reads it as the viewer and `snerg-pack info` and `check` do."""
    paper = Console(file=io.StringIO(), width=100)
    with open_pack(path) as reader:
        pack = reader.read(on_preview=skip_grid_of)
        print_facts(pack_facts(reader.files, pack), paper)
    print_findings(check_pack(pack), paper)
    for line in paper.file.getvalue().split("\n"):  # type: ignore[attr-defined]
        require_words(line)
    skip_grid_of(pack)
    if not np.isfinite(orbit_camera_for(pack).matrix).all():
        raise AssertionError("the camera stands nowhere")
    view_from_within(pack)
    photographs = Photographs(pack)
    photographs.frusta(1.0)
    for index, shot in enumerate(photographs.shots[:PICTURES]):
        require_words(shot.name, 4096)
        if shot.has_copy:
            photographs.pixels(index)
    kind_of(path)
    pack_in(path)
