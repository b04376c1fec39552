"""Exported files beside their pack, from two cameras: read by trimesh, drawn by the rasteriser here.

    python -m tools.exports_beside PACK FILE --out F.png [--size 800]

FILE is a mesh, points or Gaussians in the frame `grid`. Prints, for each camera, the intersection over union of its
silhouette with the pack's (opacity above a half).
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from scenepack import Pack, load_pack
from tests.scenepack.exports.rasteriser import draw_gaussians, draw_mesh, draw_points, overlap
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

AZIMUTHS = (30.0, 150.0)
SH_0 = 0.28209479177387814


def drawn(file: Path, camera: ViewCamera, voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture uint8 [h, w, 3] and mask bool [h, w] of an exported file."""
    read: Any
    if file.suffix == ".glb":
        (read,) = trimesh.load_scene(file, process=False).geometry.values()
    else:
        read = trimesh.load(file, process=False)
    if isinstance(read, trimesh.Trimesh):
        return draw_mesh(read.vertices, read.faces, shown_colours(read, linear=file.suffix == ".glb"), camera)
    raw = read.metadata["_ply_raw"]["vertex"]["data"]
    if "opacity" not in raw.dtype.names:
        return draw_points(read.vertices, np.asarray(read.colors)[:, :3], camera, 0.75 * voxel)
    colours = np.stack([raw[f"f_dc_{i}"] for i in range(3)], 1) * SH_0 + 0.5
    opacity = 1 / (1 + np.exp(-raw["opacity"].astype(float)))
    picture, alpha = draw_gaussians(read.vertices, np.exp(raw["scale_0"].astype(float)), opacity, colours, camera)
    return picture, alpha > 0.5


def shown_colours(mesh: trimesh.Trimesh, *, linear: bool) -> np.ndarray:
    """uint8 [v, 3] in sRGB. linear: as glTF has them."""
    visual: Any = mesh.visual  # with a material, trimesh keeps colours beside
    given = visual.vertex_colors if visual.kind == "vertex" else visual.vertex_attributes["color"]
    colours = np.asarray(given)[:, :3]
    colours = colours / 257.0 if colours.max(initial=0) > 255 else colours
    if not linear:
        return colours.astype(np.uint8)
    light = colours / 255.0
    return np.rint(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)).astype(
        np.uint8
    )


def beside(pack: Pack, file: Path, size: int = 800) -> tuple[list[float], np.ndarray]:
    """IoU of the silhouettes for each camera, and all pictures: the pack's diffuse colour over the file's."""
    found, columns = [], []
    with OffscreenRenderer(pack) as renderer:
        for azimuth in AZIMUTHS:
            camera = ViewCamera.orbit(pack, azimuth, size=(size, size))
            alpha = renderer.render_float(camera, RenderSettings(mode="alpha"))[..., 0]
            picture, mask = drawn(file, camera, pack.voxel_size)
            found.append(overlap(mask, alpha > 0.5))
            columns.append(np.concatenate([renderer.render(camera, RenderSettings(mode="diffuse")), picture]))
    return found, np.concatenate(columns, axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pack", type=Path)
    parser.add_argument("file", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--size", type=int, default=800)
    words = parser.parse_args()
    found, pictures = beside(load_pack(words.pack), words.file, words.size)
    if words.out:
        Image.fromarray(pictures).save(words.out)
    print(f"{words.file}: IoU " + ", ".join(f"{value:.4f}" for value in found))


if __name__ == "__main__":
    main()
