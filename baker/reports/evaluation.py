"""How well a run or a pack shows photographs: PSNR, SSIM, LPIPS per view (docs/commands.md, snerg-eval).

Where a scene goes on beyond the box that was trained, the paper masks photographs and pictures by the opacity of its own
pictures (appendix C.2): `by_alpha`. Several methods are compared on the same pixels where all take the mask of one: `mask_of`.

A photograph that is held out has an exposure of its own, which nothing that was trained can know. So psnr_matched is of pictures
whose colours were matched to the photograph first (baker.metrics.colours_matched).
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from baker import metrics
from baker.lpips import lpips
from console import UserError, progress
from console.atomic import replacing
from scenepack import load_pack
from scenepack.pack import Pack
from training.method import RenderOutput
from training.run import Run, is_run, load_run, read_description
from training.scenes import Camera, Photograph, Scene, picture_stems
from training.scenes.pictures import over_background
from training.scenes.scene import shown_pixels
from training.scenes.scene_options import recorded_options

Mode = Literal["normal", "alpha"]
Shown = Callable[[Camera, Mode], np.ndarray]  # a camera's picture, float32 [H, W, 3], or its opacity, float32 [H, W]
SEEN = 0.5  # opacity: a pixel that shows more of the subject than of the background


@dataclass(frozen=True)
class Drawn:
    """A subject that is drawn by `show`."""

    show: Shown
    grid_size: tuple[int, int, int] | None = None  # of a pack: its voxels (x, y, z) as drawn
    halved: bool = False  # these are fewer than it has
    bytes: int | None = None  # of a grid that is drawn without a pack


def evaluate(
    subject: Path | Run | Drawn,
    scene: Scene,
    split: str,
    images: Path | None = None,
    *,
    by_alpha: bool = False,
    mask_of: Path | None = None,
    allow_half: bool = False,
) -> dict[str, Any]:
    """The JSON of snerg-eval for a run (its folder, or loaded), a pack, or what is drawn some other way.

    images: folder for pictures beside their photographs. by_alpha: both are shown over the background wherever the subject is
    transparent; mask_of: wherever this other run or pack is. allow_half: a pack that does not fit on the graphics card is drawn
    at half its resolution.

    UserError where the subject is neither, it does not fit, or the split has no photographs.
    """
    photographs, scores = photographs_of(scene, split), []
    with ExitStack() as stack:
        drawn = stack.enter_context(shown_by(subject, allow_half, scene.path))
        mask = drawn if mask_of is None else stack.enter_context(shown_by(mask_of, allow_half, scene.path))
        bar = stack.enter_context(progress("evaluating", len(photographs)))
        for photograph, name in zip(photographs, picture_stems(photographs), strict=True):
            photographed = photograph.load()
            shown = shown_pixels(photograph.camera)  # nothing can be said of what the lens does not show
            photographed = photographed * np.concatenate([np.ones((*shown.shape, 3)), shown[..., None]], -1)
            truth, seen = over_background(photographed, scene.background), photographed[..., 3] > SEEN
            picture = drawn.show(photograph.camera, "normal")
            if by_alpha or mask_of is not None:
                opacity = mask.show(photograph.camera, "alpha")[..., None]
                seen &= opacity[..., 0] > SEEN
                both = (np.concatenate([shown, opacity], -1) for shown in (picture, truth))
                picture, truth = (over_background(shown, scene.background) for shown in both)
            scores.append(score(photograph, picture, truth, seen))
            if images is not None:
                save_comparison(images / f"{name}.png", picture, truth)
            bar.advance(metrics={"psnr": float(np.mean([each["psnr"] for each in scores]))})
    return {
        **{key: metrics.mean([each[key] for each in scores]) for key in ("psnr", "psnr_matched", "ssim", "lpips")},
        "views": scores,
        "width": photographs[0].camera.width,
        "height": photographs[0].camera.height,
        "grid_size": drawn.grid_size,
        "halved": drawn.halved,
        "mask": str(mask_of) if mask_of is not None else "own" if by_alpha else None,
    }


def photographs_of(scene: Scene, split: str) -> tuple[Photograph, ...]:
    """The photographs of a split. UserError where it has none."""
    if not (photographs := scene.splits.get(split, ())):
        raise UserError("no photographs in this split", where="--split", expected=", ".join(scene.splits), found=split)
    return photographs


def reading_of(subject: Path) -> dict[str, Any]:
    """How the subject's photographs were read: `spherify`, `masks` and `up` of training.scenes.SceneOptions, where it tells."""
    if is_run(subject):
        return recorded_options(vars(read_description(subject).options))
    return recorded_options(load_pack(subject).metadata.get("provenance"))


def score(photograph: Photograph, picture: np.ndarray, truth: np.ndarray, seen: np.ndarray) -> dict[str, Any]:
    """Scores of a picture [H, W, 3] against its photograph, both in [0, 1]. seen bool [H, W]: what is no background.

    psnr_matched: with colours matched. lpips is None where its weights are not installed.
    """
    matched = metrics.colours_matched(picture, truth, seen)
    return {
        "name": photograph.name, "psnr": metrics.psnr(picture, truth), "psnr_matched": metrics.psnr(matched, truth),
        "ssim": metrics.ssim(picture, truth), "lpips": lpips(picture, truth),
    }  # fmt: skip


@contextmanager
def shown_by(subject: Path | Run | Drawn, allow_half: bool = False, photographs: Path | None = None) -> Iterator[Drawn]:
    """What draws the subject: the field itself for a run, the OpenGL renderer for a pack.

    photographs: where a run's scene is if it is no longer where the run was trained.
    """
    if isinstance(subject, Path) and is_run(subject):
        moved = not Path(read_description(subject).scene).exists()
        subject = load_run(subject, scene_path=photographs if moved else None)
    if not isinstance(subject, Path):
        yield Drawn(partial(_field_picture, subject)) if isinstance(subject, Run) else subject
        return
    from viewer.rendering.offscreen import OffscreenRenderer

    pack = load_pack(subject)
    with OffscreenRenderer(pack, allow_half=allow_half) as renderer:
        drawn = renderer.pack.grid_size
        yield Drawn(partial(_pack_picture, pack, renderer), drawn, drawn != pack.grid_size)


def _field_picture(run: Run, camera: Camera, mode: Mode) -> np.ndarray:
    return picture_of(run.method.render(run.state, run.dataset.view_rays(camera)), camera, mode)


def picture_of(output: RenderOutput, camera: Camera, mode: Mode) -> np.ndarray:
    """See Shown."""
    shown = np.asarray(output.rgb if mode == "normal" else output.alpha)
    return np.clip(shown, 0, 1).reshape(camera.height, camera.width, *shown.shape[1:])


def _pack_picture(pack: Pack, renderer: Any, camera: Camera, mode: Mode) -> np.ndarray:
    from viewer.rendering.camera import ViewCamera
    from viewer.rendering.settings import RenderSettings

    view = ViewCamera.from_scene_camera(pack, camera)
    shown = renderer.render(view, RenderSettings(mode=mode)).astype(np.float32) / 255
    return shown if mode == "normal" else shown[..., 0]


def save_comparison(path: Path, picture: np.ndarray, truth: np.ndarray) -> None:
    """Picture, photograph and their difference times five, side by side."""
    path.parent.mkdir(parents=True, exist_ok=True)
    row = np.concatenate([picture, truth, np.clip(5 * np.abs(picture - truth), 0, 1)], axis=1)
    with replacing(path) as new:
        Image.fromarray(np.round(255 * row).astype(np.uint8)).save(new, format="PNG")
