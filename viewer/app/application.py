"""The viewer without its window: all state, and everything it can do.

Panels read it and call it; the window calls `tick` once a frame and draws while `wants_frame`. What needs OpenGL (the
picture itself) is behind `viewer.rendering.canvas.Canvas`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from console import UserError
from scenepack.pack import Pack
from scenepack.placement import moved_pose
from viewer.app.commands import COMMANDS
from viewer.core.annotations import AnnotationStore
from viewer.core.files import FileRequest, kind_of, pack_in, scene_around
from viewer.core.input import Controllers, Keyboard
from viewer.core.log import Messages
from viewer.core.pose import pose_from_text, pose_to_text
from viewer.core.state import FRAMES_AFTER_EVENT, Clipboard, Interface, OpenScene, Viewport, name_of
from viewer.features.bookmarks.bookmarks import Bookmarks, ViewPictures
from viewer.features.camera.forward_facing import orbit_camera_for
from viewer.features.camera.orbit_camera import FOVS, OrbitCamera
from viewer.features.camera.walking import Walking
from viewer.features.comparison.comparison import Comparison
from viewer.features.crop import crop
from viewer.features.display.display import TRAINED, backdrop
from viewer.features.editing.erasing import Erasing
from viewer.features.export.exporting import Exporting, Sharing
from viewer.features.film.camera_path import CameraPath
from viewer.features.film.filming import Filming, Kiosk
from viewer.features.making.making import Making
from viewer.features.measuring.measure_tool import MeasureTool
from viewer.features.measuring.surface import surface_under
from viewer.features.opening.opening import Loading, Opening, OpenPacks, OpenPrompt, looks_like_path, path_in
from viewer.features.opening.session import Sessions, load_session, restore
from viewer.features.performance.frame_stats import CostMeter, FrameStats
from viewer.features.photographs.photographs import Gallery
from viewer.features.preferences.preferences import Preferences
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.settings import RenderSettings


@dataclass(repr=False)
class App:
    """State and commands; see viewer.app.commands for the list that keys and menus use."""

    canvas: Canvas | None = None
    scene: OpenScene | None = None
    settings: RenderSettings = field(default_factory=RenderSettings)
    resolution: DynamicResolution = field(default_factory=DynamicResolution)
    times: FrameStats = field(default_factory=FrameStats)
    costs: CostMeter = field(default_factory=CostMeter)
    crop_tool: crop.Tool = "faces"  # what the mouse does to the crop box
    messages: Messages = field(default_factory=Messages)
    interface: Interface = field(default_factory=Interface)
    viewport: Viewport = field(default_factory=Viewport)
    walking: Walking = field(default_factory=Walking)
    filming: Filming = field(default_factory=Filming)
    kiosk: Kiosk | None = None  # the window shows the scene by itself
    comparison: Comparison = field(default_factory=Comparison)
    gallery: Gallery = field(default_factory=Gallery)
    annotations: AnnotationStore = field(default_factory=AnnotationStore)
    measure_tool: MeasureTool = field(default_factory=MeasureTool)
    erasing: Erasing = field(default_factory=Erasing)
    bookmarks: Bookmarks = field(default_factory=Bookmarks)
    views: ViewPictures = field(default_factory=ViewPictures)
    sessions: Sessions = field(default_factory=Sessions)
    preferences: Preferences = field(default_factory=Preferences)
    clipboard: Clipboard = field(default_factory=Clipboard)
    keyboard: Keyboard = field(default_factory=Keyboard)
    controllers: Controllers = field(default_factory=Controllers)
    file_request: FileRequest | None = None
    open_prompt: OpenPrompt | None = None  # the question what to open
    open_packs: OpenPacks = field(default_factory=OpenPacks)  # the other packs that are open
    demo: Path | None = None  # the bundled pack, where there is one
    opening: Opening = field(default_factory=Opening)
    making: Making = field(default_factory=Making)
    exporting: Exporting = field(default_factory=Exporting)
    sharing: Sharing = field(default_factory=Sharing)
    quitting: bool = False
    frames_owed: int = FRAMES_AFTER_EVENT

    @property
    def open_scene(self) -> OpenScene:
        """The open scene, for what is only done while there is one, as most commands and all pages are."""
        assert self.scene is not None
        return self.scene

    def run(self, name: str) -> bool:
        """Runs a command of COMMANDS by its id; False where it is not to be had now. A failure becomes a dialog."""
        command = COMMANDS[name]
        if not command.enabled(self):
            return False
        self.messages.crash_log(f"command {name}")
        with self.messages.as_dialog(f"“{command.title}” failed"):
            command.action(self)
        self.touch()
        return True

    # Opening

    def show(
        self, pack: Pack, path: Path, name: str | None = None, *, whole: bool = True, stays: bool = True
    ) -> OpenScene:
        """Shows a pack; whole: False where more of it is coming. UserError, with the old scene kept, if the GPU has no room.

        stays: False for a scene that is being made: it does not stay open, and its annotations are not saved.
        """
        scene = OpenScene(path, name or name_of(path), pack, self.undoable(orbit_camera_for(pack)), whole, stays)
        left = self.left_now()
        self.turn_to(scene, dialog=whole and stays)
        self.open_packs.drop(path)
        if left is not None and left.path != path:
            self.open_packs.keep(self, left)
        if whole and stays:
            self.opened()
        return scene

    def turn_to(self, scene: OpenScene, *, dialog: bool = True) -> None:
        """Shows a pack with its camera, crop and camera path. UserError, with nothing changed, if it does not fit on the GPU."""
        pack = scene.pack
        if self.canvas is not None:
            with self.messages.noting_warnings(dialog=dialog):
                self.canvas.show(pack)
        if self.scene is not None:
            self.scene.rig.stop_walking()
        self._put_tools_away()
        self.scene = scene
        if self.settings.mode in ("features", "view-dependent") and pack.view_mlp is None:
            self.settings = replace(self.settings, mode="normal")
        self.settings = replace(self.settings, crop=scene.crop, near=scene.near)
        self.filming.path = scene.camera_path or CameraPath()
        self.gallery.scene_changed(pack)
        saved = scene.path if scene.stays and scene.path.exists() else None
        self.annotations.open_pack(self, pack, saved, scene.annotations)
        # the annotations may be kept elsewhere than in the pack, which the rig knows
        scene.rig.begin_placed(self.annotations.current.placement.rotation)

    def left_now(self) -> OpenScene | None:
        """The shown pack, with what it will be shown with again; None if it does not stay open."""
        scene = self.scene
        if scene is None or not scene.whole or not scene.stays:
            return None
        scene.crop, scene.near = self.settings.crop, self.settings.near
        scene.camera_path, scene.annotations = self.filming.path, self.annotations.current
        return scene

    def refine(self, scene: OpenScene, pack: Pack, *, dialog: bool = True) -> None:
        """Shows a finer version of the open scene. UserError where it does not fit on the GPU. dialog: also shows notices."""
        if self.canvas is not None:
            with self.messages.noting_warnings(dialog=dialog):
                self.canvas.refine(pack)
        scene.pack = pack
        self.touch()

    def undoable(self, rig: OrbitCamera) -> OrbitCamera:
        """Adds crop, near plane, annotations and edits to the undo history of `rig`."""
        follow = rig.history.follow
        follow(lambda: (self.settings.crop, self.settings.near), lambda cut: self.set(crop=cut[0], near=cut[1]))
        follow(lambda: self.annotations.current, lambda marks: setattr(self.annotations, "current", marks))
        follow(lambda: self.measure_tool.draft, lambda draft: setattr(self.measure_tool, "draft", draft))
        follow(lambda: self.scene and self.scene.edits, lambda edits: setattr(self.scene, "edits", edits))
        return rig

    def opened(self) -> None:
        """Records the pack as recent and logs it, because it is complete."""
        scene = self.open_scene
        if scene.path.exists():
            self.preferences.opened(scene.path)
        self.messages.log(f"{scene.name} is open, from {scene.path}")

    def close(self) -> None:
        """Closes the shown pack and shows the last one of `open_packs`, or the start page."""
        self.comparison.drop_other(self)
        if self.canvas is not None:
            self.canvas.show(None)
        self._put_tools_away()
        self.scene = None
        self.annotations.close_pack(self)
        if self.open_packs.packs:
            self.turn_to(self.open_packs.packs.pop())

    def _put_tools_away(self) -> None:
        self.filming.cancel(self)
        self.filming = self.filming.of_another_scene()
        self.comparison.stop()
        self.measure_tool.drop()
        self.erasing = self.erasing.of_another_scene()
        self.bookmarks.drop()
        self.touch()

    def quit(self) -> None:
        """Ends the program in the next turn of its loop, without a question."""
        self.quitting = True

    def open(self, path: Path, *, other: bool = False, then: Callable[[], None] | None = None) -> None:
        """Reads a pack in a thread; tick() delivers it. other: to compare with it. then: called once it is shown."""
        self.opening.start(self, path, other=other, then=then)

    def drop(self, paths: list[Path]) -> None:
        """Handles files dropped on the window: opens a pack or session; offers to make a scene or run into one."""
        if not paths or self.kiosk is not None:
            return
        with self.messages.as_dialog(f"{paths[0].name} cannot be opened"):
            path = scene_around(paths[0])
            kind = kind_of(path)
            if kind == "session":
                restore(self, load_session(path))
                self.preferences.opened(path)
            elif kind in ("scene", "run", "pictures"):
                self.preferences.opened(path)
                self.making.offer(self, "run" if kind == "run" else "scene", path)
            else:
                self.open(pack_in(path))
        self.touch()

    @property
    def loading(self) -> Loading | None:
        return self.opening.loading

    # Each frame

    def tick(self, seconds: float) -> None:
        """Advances cameras and films, and takes over what threads have done."""
        for part in (self.opening, self.making, self.exporting, self.sharing):
            part.tick(self)
        self.walking.tick(self, seconds)
        if self.scene is not None and self.scene.rig.update(seconds):
            self.touch(2)
        self.filming.tick(self, seconds)
        if self.kiosk is not None:
            self.kiosk.tick(self)
        for part in (self.gallery, self.annotations, self.erasing, self.views, self.sessions):
            part.tick(self)
        self.comparison.tick(self, seconds)
        if self.messages.toast_changed():
            self.touch()

    def touch(self, frames: int = FRAMES_AFTER_EVENT) -> None:
        """Something changed: the next frames must be drawn."""
        self.frames_owed = max(self.frames_owed, frames)

    @property
    def wants_frame(self) -> bool:
        return self.frames_owed > 0

    def drew(self) -> None:
        self.frames_owed = max(0, self.frames_owed - 1)

    # Looking

    def camera(self) -> ViewCamera:
        """The camera of this moment in the open scene, for the whole viewport at full resolution."""
        rig, (width, height) = self.open_scene.rig, self.viewport.pixels
        rig.shape(width / height)
        return rig.camera((width, height), self.settings.near)

    def copy(self, text: str, said: str) -> None:
        self.clipboard.text = text
        self.messages.say(said)

    def pose_text(self) -> str:
        """The camera's pose in the placed frame, as one line of JSON."""
        rig, annotations = self.open_scene.rig, self.annotations.current
        parallel = rig.ortho_height * annotations.scale.factor if rig.orthographic and rig.held is None else None
        return pose_to_text(moved_pose(annotations.placed_T_grid, rig.matrix), rig.seen_fov, parallel)

    def go_to_pose(self, text: str) -> None:
        """Goes to a pose as pose_text() writes it. ValueError if it is not one."""
        matrix, fov, height = pose_from_text(text)
        annotations = self.annotations.current
        height = None if height is None else height / annotations.scale.factor
        self.open_scene.rig.set_matrix(moved_pose(np.linalg.inv(annotations.placed_T_grid), matrix), fov, height)
        self.touch()

    def paste(self) -> None:
        """Opens the path or goes to the pose on the clipboard. UserError or ValueError for other text."""
        text = self.clipboard.text
        path = path_in(text)
        if path is not None:
            self.drop([path])
        elif looks_like_path(text):
            raise UserError("there is nothing at this path", where=text.strip()[:200])
        elif self.scene is not None:
            self.go_to_pose(text)
        else:
            self.messages.say("There is no path on the clipboard", "warning")

    @property
    def picture_settings(self) -> RenderSettings:
        """The settings of what is looked at and exported, and not measured: with the look that is kept with the scene."""
        return replace(self.settings, look=self.annotations.current.look)

    def set(self, **fields: object) -> None:
        changed = replace(self.settings, **fields)  # type: ignore[arg-type]
        if changed != self.settings:
            self.settings = changed
            self.touch()

    def set_backdrop(self, style: str) -> None:
        """Shows a gradient or a checkerboard behind the scene; with PLAIN, what it is shaded over."""
        chosen = backdrop(style, self.interface.theme)
        self.set(backdrop=chosen, **({} if chosen is None else {"background": TRAINED}))

    def set_theme(self, theme: str) -> None:
        self.interface.theme = theme
        if self.settings.backdrop is not None:
            self.set_backdrop(self.settings.backdrop.style)
        self.touch()

    def cut(self, **fields: object) -> None:
        """Changes crop or near plane in one step that can be undone."""
        self.open_scene.rig.remember()
        self.set(**fields)

    def set_fov(self, degrees: float) -> None:
        rig = self.open_scene.rig
        rig.take_over()
        rig.fov = min(max(degrees, FOVS[0]), FOVS[1])
        self.touch()

    def pivot_at(self, x: float, y: float) -> None:
        """Makes the surface under a point of the viewport (window units from its corner) the pivot."""
        rig = self.open_scene.rig
        if not rig.bounded and (hit := surface_under(self, x, y)) is not None:
            rig.set_pivot(hit.point)
            self.touch()
