"""snerg-render: offscreen pictures of a pack (docs/commands.md)."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from math import ceil, sqrt
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from console import UserError, check_results, progress, run_command
from console.atomic import replacing, writing_alone
from console.command_line import parse_crop, parse_point, parse_size, require_in_range, writing_to
from console.desktop import tell_if_unseen
from scenepack import Pack, load_pack
from scenepack.placement import placed_T_grid
from training.scenes import picture_stems
from viewer.benchmark.frames import photographed_scene
from viewer.core.annotations import Annotations, read_annotations
from viewer.core.pose import FARTHEST
from viewer.features.bookmarks.bookmarks import with_places
from viewer.features.film.picture_export import (
    EXR,
    FILMS,
    MOST_FPS,
    PNG,
    Pass,
    films_possible,
    parse_modes,
    passes_for,
    require_video,
    write_exr,
    write_film,
    write_pngs,
)
from viewer.features.measuring.surface import depth_in_middle
from viewer.rendering.camera import ViewCamera, content_box, filling_orbit, is_mirrored
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import LENS_RAYS, MOST_SAMPLES, Aperture, Marcher, RenderSettings
from viewer.web.description import with_annotations

DEFAULT_SIZE, DEFAULT_FOV = "800x800", 39.0
FIRST_AZIMUTH = 30.0  # degrees, of the one picture that is made where no pose is given
TRANSPARENT = "transparent"
Projection = Literal["perspective", "equirectangular", "vr180"]
ACROSS = {"equirectangular": 360, "vr180": 180}  # degrees that the width of a picture spans; its height spans 180
PANORAMA_HEIGHT = 1024  # pixels
EXCLUDING = (
    ("--eye", "--orbit", "--scene"), ("--ortho-height", "--scene"), ("--fov", "--projection", "--ortho-height"),
    ("--aperture", "--projection"), ("--aperture", "--ortho-height"),
)  # fmt: skip
NEEDING = {
    "--target": "--eye", "--up": "--eye", "--index": "--scene", "--eye-distance": "--projection", "--focus": "--aperture",
}  # fmt: skip
LENGTHS = {  # above 0; what is wrong with others
    "--ortho-height": "is not a height", "--aperture": "is not a length", "--focus": "is not a length",
    "--eye-distance": "is not a distance",
}  # fmt: skip

View = tuple[str, tuple[ViewCamera, ...]]  # a picture's file name without suffix, and its camera, or those of two eyes


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
    mode: str = "rgb",
    marcher: Marcher = "exact",
    background: str = "1,1,1",
    format: Literal["png", "exr"] = "png",
    near: float = 0.0,
    ortho_height: float | None = None,
    projection: Projection = "perspective",
    eye_distance: float | None = None,
    aperture: float | None = None,
    focus: float | None = None,
    lens_rays: int = Aperture.rays,
    crop: str | None = None,
    surroundings: bool = True,
    look: bool = False,
    places: bool = False,
    samples: int = 1,
    sheet: bool = False,
    fps: int = 30,
) -> None:
    """Renders pictures of a pack without a display: one view, an orbit, or the views of photographs.

    Args:
        pack: Folder or .zip of a baked scene.
        out: FILE.png or FILE.exr for one view, a folder for several, FILE.mp4, FILE.webp or FILE.gif for a film.
        eye: Position of the camera, x,y,z in the placed frame (y up): the grid frame, or as it was moved in the viewer.
        target: Point that the camera looks at, x,y,z in the placed frame. The default is the centre of the content.
        up: Up direction of the camera. The default is 0,1,0.
        orbit: Render this many views on an orbit around the content.
        scene: Render the views of the photographs of this scene.
        split: Which photographs to use: test, train or val.
        index: Render only the photograph with this number, from 0.
        downscale: Divide width and height of the photographs by this whole number.
        fov: Vertical field of view in degrees. The default is 39. Photographs have their own.
        size: Picture size, WIDTHxHEIGHT in pixels. The default is 800x800, or the size of the photographs.
        mode: What to show: rgb (the picture), diffuse, features, view-dependent, alpha, depth, normals, samples, jumps,
            macroblocks or atlas; several with commas between. In an .exr, depth and normals are numbers. See docs/rendering.md.
        marcher: exact (skips empty space), paper (the paper's algorithm), or brute (takes every sample).
        background: Background colour, r,g,b in 0 ... 1; or transparent.
        format: Type of the files in a folder. A view is one .exr with all modes, or a .png for each mode.
        near: Hide everything closer than this along the optical axis, in units of the placed frame.
        ortho_height: Render without perspective, and show this many units of the placed frame from the top of the picture to the
            bottom.
        projection: perspective, equirectangular (a 360° picture, twice as wide as high) or vr180 (half of it, for both eyes).
            Such pictures are level; their middle is where the camera looks.
        eye_distance: Render a stereo picture, of eyes so many units apart: left above right, or side by side in vr180.
        aperture: Blur what is out of focus, as a lens whose opening is so many units of the placed frame across.
        focus: Distance in focus, along the optical axis, in these units. The default is that of the surface in the middle.
        lens_rays: Rays through the opening of the lens, 4 ... 4096. More take longer, and are smoother.
        crop: Show only the box x0,y0,z0,x1,y1,z1 of the grid frame.
        surroundings: Whether to show what lies beyond the inner cube of an unbounded scene.
        look: Show colours with the exposure, white balance and saturation that the viewer keeps with the pack.
        places: Draw the numbers and titles of the places that were annotated in the viewer.
        samples: Rays along each side of a pixel: 4 averages 4 x 4 rays per pixel (anti-aliasing).
        sheet: Put all views side by side on one picture, FILE.png.
        fps: Frames per second of a film.
    """
    asked = {
        "--eye": eye, "--target": target, "--up": up, "--orbit": orbit, "--scene": scene, "--index": index, "--fov": fov,
        "--ortho-height": ortho_height, "--eye-distance": eye_distance, "--aperture": aperture, "--focus": focus,
        "--projection": None if projection == "perspective" else projection,
    }  # fmt: skip
    _check_choice({option: value for option, value in asked.items() if value is not None})
    require_in_range("--fps", fps, 1, MOST_FPS)
    require_in_range("--samples", samples, 1, MOST_SAMPLES)
    require_in_range("--lens-rays", lens_rays, *LENS_RAYS)
    kind = _kind_of(out)
    transparent, exr = background == TRANSPARENT, EXR in (kind, f".{format}")
    colour = (1.0, 1.0, 1.0) if transparent else parse_point(background, "--background")
    if not all(0 <= channel <= 1 for channel in colour):
        raise UserError("is not a colour", where="--background", expected="r,g,b in 0 ... 1", found=background)
    settings = RenderSettings(
        marcher=marcher,
        background=colour,
        crop=parse_crop(crop) if crop else None,
        surroundings=surroundings,
        samples=samples,
    )
    passes = passes_for(parse_modes(mode), settings, transparent=transparent, exr=exr)
    _check_passes(passes, out, kind, exr)
    if places and passes[0].floats:
        raise UserError("needs pictures with a background, as .png or a film", where="--places")
    if sheet and (kind != PNG or passes[0].floats):
        raise UserError("is no contact sheet", where=out, expected="FILE.png, with a background")
    pixels = _size(size, projection)
    if eye_distance is not None and exr:
        raise UserError("holds one picture, not those of two eyes", where=out, remedy="name a .png or a film")
    check_results(*([out] if kind else []), folder=None if kind else out)
    loaded = with_annotations(load_pack(pack), pack)
    if loaded.ndc and (ortho_height is not None or projection != "perspective"):
        raise UserError("is a forward-facing pack, which has a perspective view alone", where=pack)
    grid_T_placed = np.linalg.inv(placed_T_grid(loaded))
    upwards = grid_T_placed[:3, :3] @ (parse_point(up, "--up") if up else (0.0, 1.0, 0.0))
    if not np.any(upwards):
        raise UserError("is not a direction", where="--up", found=up)
    shape = pixels or parse_size(DEFAULT_SIZE)
    if scene is not None:
        views = _photograph_views(loaded, scene, split, index, downscale, pixels)
    elif orbit is not None:
        path = filling_orbit(loaded, orbit, fov or DEFAULT_FOV, shape)
        views: list[View] = [(f"{i:04d}", (camera,)) for i, camera in enumerate(path)]
    else:
        views = [("view", (_posed(loaded, grid_T_placed, eye, target, upwards, fov or DEFAULT_FOV, shape),))]
    unit = abs(np.linalg.det(grid_T_placed[:3, :3])) ** (1 / 3)
    kept = read_annotations(loaded).look if look else None
    passes = [replace(each, settings=replace(each.settings, near=unit * near, look=kept)) for each in passes]
    if ortho_height is not None:
        views = [(name, (camera.as_orthographic(unit * ortho_height),)) for name, (camera,) in views]
    if projection != "perspective" and pixels:
        eyes = (0.0,) if eye_distance is None else (-0.5 * unit * eye_distance, 0.5 * unit * eye_distance)
        views = [
            (name, tuple(camera.as_panorama(pixels, upwards, ACROSS[projection], place) for place in eyes))
            for name, (camera,) in views
        ]
    if kind in (PNG, EXR) and len(views) > 1 and not sheet:
        remedy = "name a folder or a film, or choose one with --index"
        raise UserError(f"cannot hold {len(views)} pictures", where=out, remedy=remedy)
    if len({(camera.width, camera.height) for _, (camera, *_) in views}) > 1 and kind in FILMS:
        raise UserError("the photographs differ in size", where=scene, remedy="choose one with --size")
    with _written_by_us_alone(out), OffscreenRenderer(loaded, marcher) as renderer:
        lens = None if aperture is None else Aperture(unit * aperture, unit * (focus or 0.0), lens_rays)
        drawn = _drawn(renderer, views, passes, lens, annotated=places, beside=projection == "vr180")
        if kind in FILMS or sheet:
            first = (pictures[0] for _, pictures in drawn)
            write_film(out, first, fps) if kind in FILMS else _write_sheet(out, list(first))
            print(out)
            return
        if kind == "":
            out.mkdir(exist_ok=True)
        for (name, (camera, *_)), pictures in drawn:
            file = out if kind else out / f"{name}.{format}"
            if exr:
                write_exr(file, passes, pictures, camera, renderer.pack)
                print(file)
            else:
                print(*write_pngs(file, passes, pictures), sep="\n")


@contextmanager
def _written_by_us_alone(out: Path) -> Iterator[None]:
    """UserError where another process is rendering to the same place; files of two films or views would be mixed."""
    with ExitStack() as claim:
        with writing_to(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            claim.enter_context(writing_alone(out))
        yield


def _check_choice(given: Mapping[str, Any]) -> None:
    """UserError where options contradict one another, or a number makes no sense. given: what is asked for, by option."""
    if "--scene" in given and "--fov" in given:
        raise UserError("photographs have their own field of view", where="--fov", remedy="leave it out")
    for options in EXCLUDING:
        chosen = [option for option in options if option in given]
        if len(chosen) > 1:
            raise UserError("exclude each other", where=" and ".join(chosen), remedy="keep one of them")
    for option, needed in NEEDING.items():
        if option in given and needed not in given:
            raise UserError(f"needs {needed}", where=option)
    if given.get("--orbit", 1) < 1:
        raise UserError("needs at least one view", where="--orbit", found=given["--orbit"])
    if not 0.1 <= given.get("--fov", 1.0) < 179:
        raise UserError("is not a field of view", where="--fov", expected="0.1 ... 179 degrees", found=given["--fov"])
    for option, what in LENGTHS.items():
        if not 0 < given.get(option, 1.0) < FARTHEST:
            raise UserError(what, where=option, expected="above 0", found=given[option])
    if given.get("--projection") == "vr180" and "--eye-distance" not in given:
        raise UserError("needs --eye-distance", where="--projection vr180")


def _size(text: str | None, projection: Projection) -> tuple[int, int] | None:
    """Width and height of a picture of one eye, as asked for; None where that is left to the views, in perspective."""
    across = ACROSS.get(projection)
    if across is None:
        return parse_size(text) if text else None
    width, height = parse_size(text) if text else (PANORAMA_HEIGHT * across // 180, PANORAMA_HEIGHT)
    if width * 180 != height * across:
        expected = "as wide as high, for each eye" if across == 180 else "twice as wide as high, for each eye"
        raise UserError(f"is not the shape of --projection {projection}", where="--size", expected=expected, found=text)
    return width, height


def _kind_of(out: Path) -> str:
    """ ".png", ".exr", a suffix of FILMS, or "" for a folder. UserError for other suffixes, and films without PyAV."""
    suffix = "" if out.is_dir() else out.suffix.lower()
    if suffix not in ("", PNG, EXR, *FILMS):
        expected = "FILE.png, FILE.exr, FILE.mp4, FILE.webp, FILE.gif or a folder"
        raise UserError("is not a supported file type", where=out, expected=expected)
    if suffix in FILMS:
        require_video()
    if suffix == "" and out.exists() and not out.is_dir():
        raise UserError("is a file, not a folder", where=out)
    return suffix


def _posed(
    pack: Pack, grid_T_placed: np.ndarray, eye: str | None, target: str | None, up: np.ndarray, fov: float,
    size: tuple[int, int],
) -> ViewCamera:  # fmt: skip
    """eye, target: as they were given. up: in the grid frame."""
    if eye is None:
        return filling_orbit(pack, 1, fov, size, FIRST_AZIMUTH)[0]
    at = (grid_T_placed @ (*parse_point(eye, "--eye"), 1.0))[:3]
    middle = np.zeros(3) if pack.ndc else np.mean(content_box(pack), axis=0)
    towards = (grid_T_placed @ (*parse_point(target, "--target"), 1.0))[:3] if target else middle
    if np.allclose(at, towards, rtol=0, atol=1e-12):
        raise UserError("is the same point as the target", where="--eye", remedy="choose another --target")
    return ViewCamera.look_at(at, towards, up, fov, size, mirrored=is_mirrored(pack))


def _photograph_views(
    pack: Pack, scene: Path, split: str, index: int | None, downscale: int, size: tuple[int, int] | None
) -> list[View]:
    photographs = photographed_scene(pack, scene, split, downscale).splits[split]
    if index is not None and not 0 <= index < len(photographs):
        raise UserError("no such photograph", where="--index", expected=f"0 ... {len(photographs) - 1}", found=index)
    cameras = [ViewCamera.from_scene_camera(pack, photograph.camera) for photograph in photographs]
    shaped: list[tuple[ViewCamera, ...]] = [(camera.resized(*size) if size else camera,) for camera in cameras]
    views = list(zip(picture_stems(photographs), shaped, strict=True))
    return views if index is None else [views[index]]


def _check_passes(passes: list[Pass], out: Path, kind: str, exr: bool) -> None:
    """UserError where the files cannot hold what was asked for."""
    if kind in (PNG, *FILMS) and len(passes) > 1:
        names = ",".join(each.name for each in passes)
        raise UserError("cannot hold several modes", where=out, found=names, remedy="name a folder or an .exr")
    if kind in FILMS and (exr or passes[0].floats):
        raise UserError("a film has no transparent background and no numbers", where=out, remedy="name a folder")


def _drawn(
    renderer: OffscreenRenderer,
    views: list[View],
    passes: list[Pass],
    lens: Aperture | None,
    *,
    annotated: bool,
    beside: bool,
) -> Iterator[tuple[View, list[np.ndarray]]]:
    annotations = read_annotations(renderer.pack) if annotated else Annotations()
    with progress("rendering", len(views)) as bar:
        for view in views:
            name, cameras = view
            sharp = None if lens is None else _focused(renderer.pack, name, cameras[0], passes[0].settings, lens)
            pictures = []
            for each in passes:
                settings = replace(each.settings, aperture=sharp)
                draw = renderer.render_raw if each.floats else renderer.render
                eyes = [draw(camera, settings) for camera in cameras]
                if not pictures and annotations.bookmarks:
                    eyes = [
                        with_places(eye, camera, renderer.pack, settings, annotations)
                        for eye, camera in zip(eyes, cameras, strict=True)
                    ]
                pictures.append(np.concatenate(eyes, axis=int(beside)))
            yield view, pictures
            bar.advance()


def _focused(pack: Pack, name: str, camera: ViewCamera, settings: RenderSettings, lens: Aperture) -> Aperture:
    """The aperture with its focus on the surface in the middle of a view, unless it has one. UserError where it can have none."""
    if any(camera.distortion):
        what = "is of a lens that distorts, which has no depth of field here"
        raise UserError(what, where=name, remedy="leave out --aperture")
    if lens.focus:
        return lens
    focus = depth_in_middle(pack, camera, settings)
    if focus is None:
        raise UserError("shows no surface in its middle to focus on", where=name, remedy="add --focus DISTANCE")
    return replace(lens, focus=focus)


GAP = 8  # pixels between the pictures of a sheet


def _write_sheet(path: Path, pictures: list[np.ndarray]) -> None:
    """Puts pictures, uint8 [h, w, 3], side by side, row by row, in a picture about 4 : 3 of them."""
    columns = ceil(sqrt(len(pictures) * 4 / 3))
    height, width = (max(picture.shape[axis] for picture in pictures) + GAP for axis in (0, 1))
    size = min(columns, len(pictures)) * width + GAP, ceil(len(pictures) / columns) * height + GAP
    sheet = Image.new("RGB", size, (13, 17, 23))
    for i, picture in enumerate(pictures):
        sheet.paste(Image.fromarray(picture), (GAP + i % columns * width, GAP + i // columns * height))
    with replacing(path) as new:
        sheet.save(new, format="PNG")


# --- The same around a whole pack, for snerg-view where there is no display ---

SHEET_PICTURES, SHEET_SIDE = 12, 400  # how many, pixels
FILM_FRAMES, FILM_SIDE, FILM_FPS = 48, 320, 24


def fly_over(pack: Pack, name: str, folder: Path, fov: float, settings: RenderSettings) -> list[Path]:
    """Renders one turn around `pack` (fov: vertical, degrees); the files: a contact sheet, and a film where PyAV is there."""
    folder.mkdir(parents=True, exist_ok=True)
    frames = FILM_FRAMES if films_possible() else 0
    written = [folder / f"{name}-orbit.png"]
    with OffscreenRenderer(pack) as renderer, progress("rendering an orbit", SHEET_PICTURES + frames) as bar:

        def flight(count: int, side: int) -> Iterator[np.ndarray]:
            for camera in filling_orbit(pack, count, fov, (side, side)):
                yield renderer.render(camera, settings)
                bar.advance()

        _write_sheet(written[0], list(flight(SHEET_PICTURES, SHEET_SIDE)))
        if frames:
            written.append(folder / f"{name}-orbit.mp4")
            write_film(written[1], flight(frames, FILM_SIDE), FILM_FPS)
    return written


def main(args: Sequence[str] | None = None) -> int:
    return run_command(render, prog="snerg-render", args=args, on_failure=tell_if_unseen)
