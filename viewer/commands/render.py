"""snerg-render: offscreen pictures of a pack (docs/commands.md)."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from console import UserError, check_results, not_written, progress, run_command
from console.arguments import join_negative_values, parse_numbers, parse_point, parse_size
from console.atomic import replacing, writing_alone
from console.desktop import tell_if_unseen
from scenepack import Pack, load_pack
from training.scenes import load_scene, picture_stems
from viewer.app.films import MOST_FPS, require_video, write_film
from viewer.rendering.camera import ViewCamera, content_box, is_mirrored, orbit_path
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import MOST_SAMPLES, Marcher, Mode, RenderSettings

DESCRIPTION = "Renders pictures of a pack without a display: one view, an orbit, or the views of photographs."
DEFAULT_SIZE, DEFAULT_FOV = "800x800", 39.0
FIRST_AZIMUTH = 30.0  # degrees, of the one picture that is made where no pose is given
MAY_BE_NEGATIVE = ("--eye", "--target", "--up", "--crop")


@dataclass(frozen=True)
class View:
    """A picture to make: its file name without suffix, and the camera."""

    name: str
    camera: ViewCamera


def render(
    pack: Path,
    /,
    out: Path,
    eye: str | None = None,
    target: str | None = None,
    up: str | None = None,
    orbit: int | None = None,
    scene: Path | None = None,
    split: str = "test",
    index: int | None = None,
    downscale: int = 1,
    fov: float | None = None,
    size: str | None = None,
    mode: Mode = "normal",
    marcher: Marcher = "exact",
    background: str = "1,1,1",
    near: float = 0.0,
    crop: str | None = None,
    samples: int = 1,
    fps: int = 30,
) -> None:
    """Renders pictures of a pack without a display.

    Args:
        pack: Folder or .zip of a baked scene.
        out: FILE.png for one picture, a folder for several, FILE.mp4 for a film.
        eye: Position of the camera, x,y,z in the grid frame (y up).
        target: Point that the camera looks at, x,y,z in the grid frame. The default is the centre of the content.
        up: Up direction of the camera. The default is 0,1,0.
        orbit: Render this many views on an orbit around the content.
        scene: Render the views of the photographs of this scene.
        split: Which photographs to use: test, train or val.
        index: Render only the photograph with this number, from 0.
        downscale: Divide width and height of the photographs by this whole number.
        fov: Vertical field of view in degrees. The default is 39. Photographs have their own.
        size: Picture size, WIDTHxHEIGHT in pixels. The default is 800x800, or the size of the photographs.
        mode: What to show: the picture (normal), or one of the quantities behind it. See docs/rendering.md.
        marcher: exact (skips empty space), paper (the paper's algorithm), or brute (takes every sample).
        background: Background colour, r,g,b in 0 ... 1.
        near: Hide everything closer than this along the optical axis, in grid units.
        crop: Show only the box x0,y0,z0,x1,y1,z1 of the grid frame.
        samples: Rays along each side of a pixel: 4 averages 4 x 4 rays per pixel (anti-aliasing).
        fps: Frames per second of a film.
    """
    _check_choice(eye, target, up, orbit, scene, index, fov)
    if not 1 <= fps <= MOST_FPS:
        raise UserError("is out of range", where="--fps", expected=f"1 to {MOST_FPS}", found=fps)
    if not 1 <= samples <= MOST_SAMPLES:
        raise UserError("is out of range", where="--samples", expected=f"1 to {MOST_SAMPLES}", found=samples)
    kind = _kind_of(out)
    settings = RenderSettings(
        mode=mode,
        marcher=marcher,
        background=_colour(background),
        near=near,
        crop=_box(crop) if crop else None,
        samples=samples,
    )
    pixels = parse_size(size) if size else None
    if kind:
        check_results(out)
    else:
        check_results(folder=out)
    loaded = load_pack(pack)
    if scene is not None:
        views = _photograph_views(loaded, scene, split, index, downscale, pixels)
    elif orbit is not None:
        path = orbit_path(loaded, orbit, fov or DEFAULT_FOV, pixels or parse_size(DEFAULT_SIZE))
        views = [View(f"{i:04d}", camera) for i, camera in enumerate(path)]
    else:
        views = [View("view", _posed(loaded, eye, target, up, fov or DEFAULT_FOV, pixels or parse_size(DEFAULT_SIZE)))]
    if kind == ".png" and len(views) > 1:
        raise UserError(
            f"cannot hold {len(views)} pictures",
            where=out,
            remedy="name a folder or an .mp4, or choose one with --index",
        )
    if len({(v.camera.width, v.camera.height) for v in views}) > 1 and kind == ".mp4":
        raise UserError("the photographs differ in size", where=scene, remedy="choose one with --size")
    with _written_by_us_alone(out), OffscreenRenderer(loaded, marcher) as renderer:
        _write(out, kind, views, _pictures(renderer, views, settings), fps)


@contextmanager
def _written_by_us_alone(out: Path) -> Iterator[None]:
    """UserError where another process is rendering to the same place; files of two films or views would be mixed."""
    with ExitStack() as stack:
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(writing_alone(out))
        except OSError as error:
            words, remedy = not_written(error)
            raise UserError(f"cannot be written: {words}", where=out, remedy=remedy) from error
        yield


def _check_choice(
    eye: str | None,
    target: str | None,
    up: str | None,
    orbit: int | None,
    scene: Path | None,
    index: int | None,
    fov: float | None,
) -> None:
    """UserError where the ways of saying what to look at contradict one another, or a number makes no sense."""
    chosen = [name for name, given in (("--eye", eye), ("--orbit", orbit), ("--scene", scene)) if given is not None]
    if len(chosen) > 1:
        raise UserError("exclude each other", where=" and ".join(chosen), remedy="keep one of them")
    if eye is None and (target is not None or up is not None):
        raise UserError("needs --eye", where="--target" if target is not None else "--up")
    if scene is None and index is not None:
        raise UserError("needs --scene", where="--index")
    if orbit is not None and orbit < 1:
        raise UserError("needs at least one view", where="--orbit", found=orbit)
    if fov is not None and scene is not None:
        raise UserError("photographs have their own field of view", where="--fov", remedy="leave it out")
    if fov is not None and not 0.1 <= fov < 179:
        raise UserError("is not a field of view", where="--fov", expected="0.1 ... 179 degrees", found=fov)


def _kind_of(out: Path) -> str:
    """ ".png", ".mp4" or "" for a folder. UserError for other suffixes, and for films where they cannot be made."""
    suffix = "" if out.is_dir() else out.suffix.lower()
    if suffix not in ("", ".png", ".mp4"):
        raise UserError("is not a supported file type", where=out, expected="FILE.png, FILE.mp4 or a folder")
    if suffix == ".mp4":
        require_video()
    if suffix == "" and out.exists() and not out.is_dir():
        raise UserError("is a file, not a folder", where=out)
    return suffix


def _colour(text: str) -> tuple[float, float, float]:
    colour = parse_point(text, "--background")
    if not all(0 <= channel <= 1 for channel in colour):
        raise UserError("is not a colour", where="--background", expected="r,g,b in 0 ... 1", found=text)
    return colour


def _box(text: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    x0, y0, z0, x1, y1, z1 = parse_numbers(text, 6, "--crop")
    return (x0, y0, z0), (x1, y1, z1)


def _posed(
    pack: Pack, eye: str | None, target: str | None, up: str | None, fov: float, size: tuple[int, int]
) -> ViewCamera:
    if eye is None:
        if pack.ndc:
            return orbit_path(pack, 1, fov, size)[0]
        return ViewCamera.orbit(pack, FIRST_AZIMUTH, fov_degrees=fov, size=size)
    at = parse_point(eye, "--eye")
    middle = np.zeros(3) if pack.ndc else np.mean(content_box(pack), axis=0)
    towards = np.asarray(parse_point(target, "--target")) if target else middle
    upwards = parse_point(up, "--up") if up else (0.0, 1.0, 0.0)
    if not np.any(upwards):
        raise UserError("is not a direction", where="--up", found=up)
    if np.allclose(at, towards, rtol=0, atol=1e-12):
        raise UserError("is the same point as the target", where="--eye", remedy="choose another --target")
    return ViewCamera.look_at(at, towards, upwards, fov, size, mirrored=is_mirrored(pack))


def _photograph_views(
    pack: Pack, scene: Path, split: str, index: int | None, downscale: int, size: tuple[int, int] | None
) -> list[View]:
    splits = load_scene(scene, downscale=downscale).splits
    photographs = splits.get(split, ())
    if not photographs:
        names = ", ".join(name for name, some in splits.items() if some)
        raise UserError("has no such photographs", where=scene, expected=f"--split {names}", found=split)
    if index is not None and not 0 <= index < len(photographs):
        raise UserError("no such photograph", where="--index", expected=f"0 ... {len(photographs) - 1}", found=index)
    views = []
    for number, (photograph, name) in enumerate(zip(photographs, picture_stems(photographs), strict=True)):
        if index is not None and number != index:
            continue
        camera = ViewCamera.from_scene_camera(pack, photograph.camera)
        views.append(View(name, camera.resized(*size) if size else camera))
    return views


def _pictures(renderer: OffscreenRenderer, views: list[View], settings: RenderSettings) -> Iterator[np.ndarray]:
    with progress("rendering", len(views)) as bar:
        for view in views:
            yield renderer.render(view.camera, settings)
            bar.advance()


def _write(out: Path, kind: str, views: list[View], pictures: Iterator[np.ndarray], fps: int) -> None:
    """Writes pictures as they come, each file aside first and then renamed, and prints what was written."""
    if kind == "":
        out.mkdir(exist_ok=True)
    if kind == ".mp4":
        write_film(out, pictures, fps)
        print(out)
        return
    for view, picture in zip(views, pictures, strict=True):
        path = out if kind == ".png" else out / f"{view.name}.png"
        with replacing(path) as new:
            Image.fromarray(picture).save(new, format="PNG")
        print(path)


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of snerg-render; returns the exit status."""
    words = join_negative_values(sys.argv[1:] if args is None else args, MAY_BE_NEGATIVE)
    return run_command(render, prog="snerg-render", description=DESCRIPTION, args=words, on_failure=tell_if_unseen)


if __name__ == "__main__":
    sys.exit(main())
