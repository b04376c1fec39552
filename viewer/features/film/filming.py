"""The app's camera path: editing it, playing it back, also by itself as a kiosk, and exporting stills and films."""

from __future__ import annotations

import io
import time
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from console import UserError
from viewer.core.annotations import Point
from viewer.core.files import FileRequest
from viewer.core.pose import fitted
from viewer.features.bookmarks.bookmarks import Rearranging, rearranged, with_places
from viewer.features.film.camera_path import CameraPath, Keyframe, load_path, save_path
from viewer.features.film.picture_export import EXR, VIEWS, Export, passes_for
from viewer.features.measuring.surface import depth_in_middle, depth_of
from viewer.rendering.camera import ViewCamera, forward_facing_path
from viewer.rendering.settings import Aperture, Mode

if TYPE_CHECKING:
    from viewer.app.application import App

Size = tuple[int, int]  # width, height in pixels
SIZES: dict[Size, str] = {(1920, 1080): "Full HD", (3840, 2160): "4K", (1080, 1080): "Square", (640, 360): "Small"}
PANORAMA_SIZES: dict[Size, str] = {(4096, 2048): "4K", (8192, 4096): "8K", (1024, 512): "Small"}
STEP_S = 0.02  # of a frame's time that an export takes
TURNTABLE_KEYS = 8
LARGEST_SIDE = 16384
SMALLEST_TILE = 16  # pixels a side
STILL_MODES: dict[Mode, str] = {
    "depth": "Depth",
    "normals": "Normals",
    "alpha": "Opacity",
    "diffuse": "Diffuse colour",
}  # besides the picture
COPY = Path("the clipboard")
KEPT = ("size", "panorama", "fps", "samples", "besides", "transparent", "annotated", "lens_rays")
LENS_QUALITY = {16: "Draft", 64: "Good", 256: "Fine"}  # rays through the opening of the lens
SAMPLES = {1: "Off", 2: "2 × 2", 4: "4 × 4"}  # rays along each side of a pixel


@dataclass
class Filming:
    """The camera path of the open scene, and how stills and films are written."""

    path: CameraPath = field(default_factory=CameraPath)
    selected: int | None = None  # a keyframe's index
    time: float = 0.0  # seconds along the path
    playing: bool = False
    size: Size = (1920, 1080)  # of stills and films
    panorama: bool = False  # they show all directions, level (equirectangular), twice as wide as high
    fps: float = 30.0
    samples: int = 1  # rays along each side of a pixel; see RenderSettings
    besides: tuple[Mode, ...] = ()  # modes that a still is saved in besides the one that is shown
    transparent: bool = False  # stills have no background
    annotated: bool = False  # numbers and titles of annotated places are drawn into stills and films with a background
    aperture: float = 0.0  # of stills: diameter of the opening of the lens, of the scene's radius; 0: all is sharp
    lens_rays: int = 64
    focus: Point | None = None  # what is in focus, grid frame; None: what is in the middle of the picture
    export: Export | None = None
    _held: ViewCamera | None = None  # what playing showed last

    def of_another_scene(self) -> Filming:
        """What stays when another scene is opened: how stills and films are written."""
        return Filming(**{name: getattr(self, name) for name in KEPT})

    def set_size(self, width: int, height: int) -> None:
        """Pixels of stills and films, within what is possible; of a panorama the side that was changed counts."""
        width, height = (min(max(side, 16), LARGEST_SIDE) for side in (width, height))
        if self.panorama:
            height = width // 2 if width != self.size[0] else min(height, LARGEST_SIDE // 2)
            width = 2 * height
        self.size = width, height

    def _view(self, app: App, camera: ViewCamera) -> ViewCamera:
        """What is written of what `camera` sees."""
        return camera.as_panorama(self.size, app.open_scene.rig.table.axes[1]) if self.panorama else camera

    def use(self, path: CameraPath) -> None:
        """Takes another path, from its start."""
        self.path, self.selected, self.time, self.playing = path, None, 0.0, False

    def add(self, app: App) -> None:
        """Makes the present view a keyframe, after the selected one."""
        keys, rig = self.path.keyframes, app.open_scene.rig
        self.selected = len(keys) if self.selected is None else self.selected + 1
        keys.insert(self.selected, Keyframe(rig.matrix.copy(), rig.seen_fov))
        app.messages.say(f"Keyframe {self.selected + 1} of {len(keys)}")

    def rearrange(self, app: App, how: Rearranging, index: int) -> None:
        keys, rig = self.path.keyframes, app.open_scene.rig
        here = replace(keys[index], grid_T_camera=rig.matrix.copy(), fov=rig.seen_fov)
        self.path.keyframes, self.selected = rearranged(keys, how, index, here)
        self.playing = self.playing and bool(self.path.keyframes)

    def select(self, app: App, index: int) -> None:
        self.selected = index
        self.show(app, self.path.start_of(index))

    def show(self, app: App, seconds: float) -> None:
        """Shows the view at a time of the path, which has keyframes."""
        self.time = min(max(seconds, 0.0), self.path.duration)
        matrix, fov = self.path.at(self.time)
        self._held = ViewCamera.posed(matrix, fov, app.viewport.pixels)
        app.open_scene.rig.hold(self._held)
        app.touch()

    def play(self, app: App) -> None:
        """Starts or stops playing; from the start again where the end was reached."""
        self.playing, self._held = not self.playing and len(self.path.keyframes) > 1, None
        if self.playing:
            app.open_scene.rig.remember()
            if self.time >= self.path.duration - 1e-6:
                self.time = 0.0

    def tick(self, app: App, seconds: float) -> None:
        if self.playing and self._held not in (None, app.open_scene.rig.held):
            self.playing = False  # somebody moved the camera
        if self.playing:
            self.time += seconds
            if self.time >= self.path.duration:
                if self.path.closed:
                    self.time %= max(self.path.duration, 1e-9)
                else:
                    self.time, self.playing = self.path.duration, False
            self.show(app, self.time)
        if self.export is not None:
            self._step(app, self.export)
            app.touch(2)

    def turntable(self, app: App) -> None:
        """A closed path around the scene, as high and far as the camera is; from the first view, where all sides are seen."""
        rig = app.open_scene.rig
        rig.take_over()
        if rig.bounded:
            raise UserError("a turntable does not work with a forward-facing pack")
        turns = [360.0 * i / TURNTABLE_KEYS for i in range(TURNTABLE_KEYS)]
        pose = rig.goal
        if pose == rig.home_pose and not rig.within:  # nobody chose the distance: no side shall be cut off
            sides = [rig.framing_distance(pose.azimuth + turn, pose.elevation, rig.fov) for turn in turns]
            pose = replace(pose, distance=max(sides))
        matrices = [replace(pose, azimuth=pose.azimuth + turn).matrix(rig.table) for turn in turns]
        self.use(CameraPath([Keyframe(matrix, rig.fov, 1.0) for matrix in matrices], closed=True))
        app.messages.say("A turntable of 8 seconds")

    # Files

    def save(self, app: App, file: Path) -> None:
        if app.scene is not None:
            save_path(self.path, file, app.scene.pack.worldspace_T_opengl, self.size, self.fps)
            app.messages.say(f"Saved {file}")

    def load(self, app: App, file: Path) -> None:
        """Reads such a file; the path that was there stays where it cannot be read."""
        if app.scene is not None:
            self.use(load_path(file, app.scene.pack.worldspace_T_opengl))
            app.messages.say(f"{len(self.path.keyframes)} keyframes from {file.name}")

    def still(self, app: App, target: Path, camera: ViewCamera | None = None) -> None:
        """Starts to write a camera's view, by default the present one at `size`."""
        if app.scene is None:
            return
        rig = app.scene.rig
        if self.panorama:
            camera = ViewCamera.posed(rig.matrix, rig.seen_fov, self.size)
        elif camera is None:  # its height stays, or its width in a narrower one
            camera = fitted(rig.camera(app.viewport.pixels, app.settings.near), self.size)
        lens = None if self.panorama else self._lens(app, camera)
        self._start(app, [self._view(app, camera)], target, lens)

    def _lens(self, app: App, camera: ViewCamera) -> Aperture | None:
        """Of a still. UserError where the camera can have none."""
        if not self.aperture:
            return None
        scene = app.open_scene
        if camera.orthographic or any(camera.distortion):
            raise UserError("depth of field needs perspective without a distorting lens", remedy="switch it off")
        at = self.focus
        focus = depth_in_middle(scene.pack, camera, app.settings) if at is None else depth_of(camera, np.array(at))
        if focus is None or focus <= 0:
            raise UserError("there is nothing to focus on", remedy="click on what shall be in focus")
        return Aperture(self.aperture * scene.rig.radius, focus, self.lens_rays)

    def ask_for_still(self, app: App) -> None:
        then, name = partial(self.still, app), f"{app.open_scene.name}.png"
        app.file_request = FileRequest("Save the picture", "save", then, (".png", ".exr"), name)

    def copy(self, app: App) -> None:
        """Starts to put the picture of this moment, at the viewport's size, on the clipboard."""
        self._start(app, [app.camera()], COPY)

    def film(self, app: App, target: Path) -> None:
        """Starts to write the path: a film, or a folder of PNGs."""
        if not self.path.keyframes:
            raise UserError("the path has no keyframes yet", remedy="add some, or make a turntable")
        cameras = [ViewCamera.posed(matrix, fov, self.size) for matrix, fov in self.path.sample(self.fps)]
        self._start(app, [self._view(app, camera) for camera in cameras], target)

    def _start(self, app: App, cameras: list[ViewCamera], target: Path, lens: Aperture | None = None) -> None:
        if self.export is not None:
            raise UserError("another export is still running", remedy="cancel it or wait for it")
        if app.canvas is None or app.scene is None:
            return
        if self.panorama and app.scene.rig.bounded:
            raise UserError("a forward-facing pack has no 360° pictures")
        if not app.scene.whole:
            raise UserError("the scene is still being read", remedy="wait until it is complete")
        side = max(app.resolution.tile_side() // self.samples, SMALLEST_TILE)
        side = side if lens is None else max(round(side / lens.rays**0.5), SMALLEST_TILE)
        settings = replace(app.picture_settings, samples=self.samples, aperture=lens)
        suffix = target.suffix.lower()
        still = suffix in VIEWS
        modes = tuple(dict.fromkeys((settings.mode, *(self.besides if still else ()))))
        passes = passes_for(modes, settings, transparent=still and self.transparent, exr=suffix == EXR)
        pack, put, finish = app.scene.pack, copy_picture if target is COPY else None, None
        if self.annotated:
            finish = partial(with_places, pack=pack, settings=settings, annotations=app.annotations.current)
        self.export = Export(cameras, passes, target, app.canvas, pack, self.fps, side, finish, put)
        self.playing = False
        app.touch()

    def _step(self, app: App, export: Export) -> None:
        copies = export.target is COPY
        try:
            export.step(STEP_S)
        except Exception as error:  # a full disk: a dialog, and the program goes on
            self.export = None
            app.messages.fail("The picture is not on the clipboard" if copies else "The export stopped", error)
            return
        if export.finished:
            self.export = None
            app.messages.say("The picture is on the clipboard" if copies else f"Saved {export.target}")

    def cancel(self, app: App) -> None:
        """Stops the export; nothing of it is left on disk."""
        if self.export is not None:
            self.export.cancel()
            self.export = None
            app.messages.say("The export was cancelled")


REMEDY = "save it with Ctrl+S instead"
LARGEST_BYTES = 15 << 20  # of a PNG: X11 hands over what fits into one request


def copy_picture(picture: np.ndarray) -> None:
    """Puts a picture, uint8 [h, w, 3], on the clipboard until the program ends. UserError where that is impossible."""
    import copykitten

    if picture.nbytes > LARGEST_BYTES:
        png = io.BytesIO()
        Image.fromarray(picture).save(png, format="PNG", compress_level=1)
        if png.tell() > LARGEST_BYTES:
            raise UserError("the picture is too large for the clipboard", remedy=REMEDY)
    height, width = picture.shape[:2]
    try:
        copykitten.copy_image(Image.fromarray(picture).convert("RGBA").tobytes(), width, height)
    except copykitten.CopykittenError as error:
        raise UserError("the clipboard cannot be reached", found=str(error), remedy=REMEDY) from error


# --- The kiosk ---

IDLE_S = 60.0  # without a movement of the camera, before it begins again
TURN_S = 40.0  # of a turntable
LEG_S = 8.0  # from one bookmark to the next
SWAY_KEYS = 8  # of a forward-facing scene
KIOSK_COMMANDS = ("home", "frame", "escape", "full-screen", "quit")  # that keys still run


@dataclass
class Kiosk:
    """A scene that shows itself, full screen and without panels, and waits while somebody moves the camera."""

    began: bool = False  # the path of the scene is known
    tour: bool = False  # it leads through the bookmarks
    moved_at: float = 0.0  # when the camera moved last, seconds of the monotonic clock
    _goal: object = None

    def tick(self, app: App) -> None:
        """Plays the path once the scene is there, and again IDLE_S after somebody moved the camera the last time."""
        if app.scene is None or not app.scene.whole:
            return
        filming, now = app.filming, time.monotonic()
        if not self.began:
            self.began = True
            filming.use(self._path(app))
            filming.play(app)
        elif filming.playing or app.scene.rig.goal != self._goal:
            self.moved_at, self._goal = now, app.scene.rig.goal
            if filming.playing and self.tour:
                app.bookmarks.selected = round(filming.time / LEG_S) % len(filming.path.keyframes)
        elif now - self.moved_at > IDLE_S:
            filming.time = 0.0
            filming.play(app)

    def _path(self, app: App) -> CameraPath:
        """The camera path that was loaded, or one through the bookmarks, or a turn; without an end."""
        filming, scene = app.filming, app.open_scene
        if len(filming.path.keyframes) > 1:
            keys = filming.path.keyframes
        elif len(app.annotations.current.bookmarks) > 1:
            self.tour = True
            keys = [replace(key, seconds=LEG_S) for key in app.bookmarks.keyframes(app)]
        elif scene.rig.bounded:
            cameras = forward_facing_path(scene.pack, SWAY_KEYS)
            keys = [Keyframe(camera.grid_T_camera, scene.rig.seen_fov, TURN_S / SWAY_KEYS) for camera in cameras]
        else:
            filming.turntable(app)
            turn = filming.path.keyframes
            keys = [replace(key, seconds=TURN_S / len(turn)) for key in turn]
        return CameraPath(keys, closed=True)
