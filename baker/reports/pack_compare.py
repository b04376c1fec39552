"""Two packs side by side: each drawn by the OpenGL renderer from the same cameras, picture by picture.

Needs neither JAX nor photographs. Cameras go once around the first pack's content (along a circle in the camera plane
for forward-facing packs), in the OpenGL grid frame that both packs are taken to share.
"""

from pathlib import Path
from typing import Any

import numpy as np

from baker import metrics
from console import UserError, progress
from scenepack import load_pack
from scenepack.files import stored_bytes
from viewer.rendering.camera import orbit_path
from viewer.rendering.offscreen import OffscreenRenderer


def compare_packs(first: Path, second: Path, views: int, size: tuple[int, int]) -> dict[str, Any]:
    """PSNR (dB, at most 120) and SSIM of the second pack's pictures against the first's, and bytes on disk.

    {"a", "b": {"path", "bytes", "codec"}, "width", "height", "psnr", "ssim", "worst" (of 255), "views": [{"name",
    "psnr", "ssim", "worst"}]}; ssim is None for pictures too small for it. UserError where a pack cannot be opened, or
    only one of them is forward-facing.
    """
    packs = load_pack(first), load_pack(second)
    if packs[0].ndc != packs[1].ndc:
        raise UserError("only one of the packs is forward-facing (NDC)", where=first if packs[0].ndc else second)
    cameras = orbit_path(packs[0], views, size=size)
    pictures: list[list[np.ndarray]] = [[], []]
    with progress("comparing", 2 * views) as bar:
        for pack, drawn in zip(packs, pictures, strict=True):
            with OffscreenRenderer(pack) as renderer:
                for camera in cameras:
                    drawn.append(renderer.render(camera))
                    bar.advance()
    rows = [{"name": f"view {i}", **difference(a, b)} for i, (a, b) in enumerate(zip(*pictures, strict=True))]
    return {
        **{
            name: {"path": str(path), "bytes": stored_bytes(path), "codec": str(pack.params.get("format", "png"))}
            for name, path, pack in zip("ab", (first, second), packs, strict=True)
        },
        "width": size[0],
        "height": size[1],
        **{key: metrics.mean([row[key] for row in rows]) for key in ("psnr", "ssim")},
        "worst": max(row["worst"] for row in rows),
        "views": rows,
    }


def difference(a: np.ndarray, b: np.ndarray) -> dict[str, Any]:
    """psnr, ssim (None for pictures too small for it) and worst, the largest difference, of uint8 [H, W, 3]."""
    x, y = a.astype(np.float32) / 255, b.astype(np.float32) / 255
    ssim = metrics.ssim(x, y) if min(a.shape[:2]) >= metrics.WINDOW else None
    return {"psnr": metrics.psnr(x, y), "ssim": ssim, "worst": int(np.abs(a.astype(int) - b).max())}
