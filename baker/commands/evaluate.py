"""`snerg-eval (RUN|PACK) --scene SCENE`: image quality against photographs (docs/commands.md)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from console import check_results, run_command, write_json
from console.streams import one_line
from training.libraries import begin_libraries


def snerg_eval(
    subject: Path,
    /,
    scene: Path,
    split: str = "test",
    downscale: int = 1,
    spherify: bool = False,
    masks: bool = False,
    mask_by_alpha: bool = False,
    mask_of: Path | None = None,
    allow_half: bool = False,
    json: Path | None = None,
    images: Path | None = None,
) -> None:
    """Compares a run, or a pack rendered with OpenGL, with the photographs of a scene: PSNR (dB), SSIM and LPIPS.

    "Matched" is the PSNR after a gain and an offset for each colour channel, fitted to each photograph: exposure and white
    balance of photographs that were not trained on cannot be known.

    Args:
        subject: Folder of a run, or a pack (folder or .zip).
        scene: Folder of the photographs.
        split: Which photographs to use: test, train or val.
        downscale: Divide width and height of the photographs by this whole number.
        spherify: Read an LLFF or COLMAP scene as a 360 degree scene. Set automatically if the run or pack was trained so.
        masks: Cut the object out with the masks next to the pictures. Set automatically likewise.
        mask_by_alpha: Compare only where the run or pack is opaque, as the paper does for real 360 degree scenes.
        mask_of: Compare only where this other run or pack is opaque. Give the same one for all methods that you compare.
        allow_half: Measure a pack that does not fit on the graphics card at half its resolution. Without this option, such a
            pack is refused.
        json: Also write the scores to this file; "-" prints them instead of the text.
        images: Folder for pictures: the rendering, the photograph, and five times their difference.
    """
    begin_libraries()  # JAX starts here, not for --help
    from baker.reports.evaluation import evaluate, reading_of
    from training.scenes import load_scene
    from viewer.rendering.gpu_scene import OR_HALF, NoRoomError

    check_results(json, folder=images)
    made = reading_of(subject)
    photographed = load_scene(
        scene, downscale=downscale, spherify=spherify or made["spherify"], masks=masks or made["masks"], up=made["up"]
    )
    try:
        result = evaluate(
            subject, photographed, split, images, by_alpha=mask_by_alpha, mask_of=mask_of, allow_half=allow_half
        )
    except NoRoomError as error:
        raise error if allow_half else error.with_remedy(OR_HALF) from error
    if write_json(json, result):
        return
    lpips = "-" if result["lpips"] is None else f"{result['lpips']:.4f}"
    grid = f"; {' x '.join(map(str, result['grid_size']))} voxels" if result["grid_size"] else ""
    grid += ", fewer than the pack has" if result["halved"] else ""
    for view in result["views"]:
        print(one_line(f"{view['name']}: {_psnr(view)}, SSIM {view['ssim']:.4f}"))
    print(
        f"mean of {len(result['views'])} views at {result['width']} x {result['height']}: PSNR {_psnr(result)}, "
        f"SSIM {result['ssim']:.4f}, LPIPS {lpips}{grid}"
    )


def _psnr(scores: Mapping[str, Any]) -> str:
    return f"{scores['psnr']:.2f} dB ({scores['psnr_matched']:.2f} dB matched)"


def main(args: Sequence[str] | None = None) -> int:
    return run_command(snerg_eval, prog="snerg-eval", args=args)
