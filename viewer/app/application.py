"""The viewer without its window: all state, and everything it can do.

Panels read it and call it; the window calls `tick` once a frame and draws while `wants_frame`. What needs OpenGL (the
picture itself) is behind `viewer.app.stage.Stage`, which viewer.window.canvas implements.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import atan, degrees
from pathlib import Path

import numpy as np

from console import UserError
from scenepack.pack import Pack
from viewer.app import crop
from viewer.app.comparison import Comparison
from viewer.app.files import FileRequest, kind_of, pack_in, scene_around
from viewer.app.filming import Filming
from viewer.app.first_look import Look
from viewer.app.forward_facing import rig_for
from viewer.app.gallery import Gallery
from viewer.app.keyboard import Keyboard
from viewer.app.loading import Loading
from viewer.app.log import Messages
from viewer.app.making import Making
from viewer.app.opening import Opening
from viewer.app.pose import pose_from_text, pose_to_text
from viewer.app.preferences import Preferences
from viewer.app.projection import rays_through
from viewer.app.ray_costs import CostMeter
from viewer.app.rig import FOVS, CameraRig
from viewer.app.stage import Stage
from viewer.app.state import FRAMES_AFTER_EVENT, Clipboard, Interface, OpenScene, Viewport, name_of
from viewer.app.timing import FrameTimes
from viewer.rendering.camera import ViewCamera
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.settings import RenderSettings


@dataclass(repr=False)
class App:
    """State and commands; see viewer.app.commands for the list that keys and menus use."""

    stage: Stage | None = None
    scene: OpenScene | None = None
    settings: RenderSettings = field(default_factory=RenderSettings)
    resolution: DynamicResolution = field(default_factory=DynamicResolution)
    times: FrameTimes = field(default_factory=FrameTimes)
    costs: CostMeter = field(default_factory=CostMeter)
    crop_tool: crop.Tool = "faces"  # what the mouse does to the crop box
    messages: Messages = field(default_factory=Messages)
    interface: Interface = field(default_factory=Interface)
    viewport: Viewport = field(default_factory=Viewport)
    filming: Filming = field(default_factory=Filming)
    comparison: Comparison = field(default_factory=Comparison)
    gallery: Gallery = field(default_factory=Gallery)
    preferences: Preferences = field(default_factory=Preferences)
    clipboard: Clipboard = field(default_factory=Clipboard)
    keyboard: Keyboard = field(default_factory=Keyboard)
    file_request: FileRequest | None = None
    demo: Path | None = None  # the bundled pack, where there is one
    opening: Opening = field(default_factory=Opening)
    making: Making = field(default_factory=Making)
    quitting: bool = False
    frames_owed: int = FRAMES_AFTER_EVENT

    # Opening

    def show(self, pack: Pack, path: Path, name: str | None = None, *, whole: bool = True) -> None:
        """Shows a pack that was read. Raises UserError, with the old scene kept, where the card refuses it.

        whole: False where more of it is on its way.
        """
        if self.stage is not None:
            with self.messages.noting_warnings(told=whole):
                self.stage.show(pack)
        self.scene = OpenScene(path, name or name_of(path), pack, self.undoable(rig_for(pack)), whole)
        if self.settings.mode in ("features", "view-dependent") and pack.view_mlp is None:
            self.settings = replace(self.settings, mode="normal")
        self.settings = replace(self.settings, crop=None, near=0.0)
        if self.filming.export is not None:
            self.filming.cancel(self)
        self.filming = self.filming.of_another_scene()
        self.comparison.stop()
        self.gallery.scene_changed(pack)
        if whole:
            self.opened()
        self.touch()

    def show_look(self, look: Look, path: Path, name: str) -> None:
        """Shows the points and cameras of a scene that is being made, from outside, with their photographs."""
        self.show(look.pack, path, name, whole=False)
        assert self.scene is not None
        self.scene.whole = True
        self.scene.rig.begin_at(look.overview())
        self.gallery.frusta = True
        self.touch()

    def undoable(self, rig: CameraRig) -> CameraRig:
        """`rig`, with what is cut off in its history as well."""
        rig.history.follow(
            lambda: (self.settings.crop, self.settings.near), lambda cut: self.set(crop=cut[0], near=cut[1])
        )
        return rig

    def opened(self) -> None:
        """The whole pack is there: it is remembered, and told."""
        assert self.scene is not None
        if self.scene.path.exists():
            self.preferences.opened(self.scene.path)
        self.messages.log(f"{self.scene.name} is open, from {self.scene.path}")

    def close(self) -> None:
        """Back to the start page."""
        if self.filming.export is not None:
            self.filming.cancel(self)
        self.comparison.drop_other(self)
        self.comparison.stop()
        if self.stage is not None:
            self.stage.show(None)
        self.scene, self.filming = None, self.filming.of_another_scene()
        self.touch()

    def quit(self) -> None:
        """Ends the program with the next turn of its loop, without a question."""
        self.quitting = True

    def use(self, preferences: Preferences) -> None:
        """Takes over what was remembered."""
        self.preferences = preferences
        self.interface.page = preferences.page
        self.interface.moved, self.interface.layout = list(preferences.moved), preferences.layout
        self.settings = replace(self.settings, background=preferences.background)
        self.resolution.target_fps, self.resolution.enabled = preferences.target_fps, preferences.dynamic_resolution
        self.resolution.rest_scale = preferences.rest_scale

    def remembered(self) -> Preferences:
        """What is to be remembered."""
        return replace(
            self.preferences,
            page=self.interface.page,
            moved=list(self.interface.moved),
            layout=self.interface.layout,
            background=self.settings.background,
            target_fps=self.resolution.target_fps,
            dynamic_resolution=self.resolution.enabled,
            rest_scale=self.resolution.rest_scale,
        )

    def open(
        self,
        path: Path,
        *,
        other: bool = False,
        then: Callable[[], None] | None = None,
    ) -> None:
        """Starts to read a pack; what comes of it shows itself in later ticks.

        other: to compare with it. then: called once it is shown.
        """
        self.opening.start(self, path, other=other, then=then)

    def compare_with(self, pack: Pack, path: Path) -> None:
        """Compares with another pack under the same camera. UserError where the card has no room for both."""
        self.comparison.with_pack(self, pack, path)
        self.gallery.chosen = None

    def drop(self, paths: list[Path]) -> None:
        """Files were dropped on the window: a pack is opened; a scene or a run may be made into one."""
        if not paths:
            return
        try:
            self._drop(paths[0])
        except (OSError, UserError) as error:
            self.messages.fail(f"{paths[0].name} cannot be opened", error)
        self.touch()

    def _drop(self, path: Path) -> None:
        path = scene_around(path)
        kind = kind_of(path)
        if kind in ("scene", "run", "pictures"):
            self.making.offer(self, "run" if kind == "run" else "scene", path)
        else:
            self.open(pack_in(path))

    @property
    def loading(self) -> Loading | None:
        """The pack that is being read."""
        return self.opening.loading

    def cancel_loading(self) -> None:
        """Gives up reading; the scene that is open stays."""
        self.opening.cancel(self)

    # Each frame

    def tick(self, seconds: float) -> None:
        """Time passes: cameras glide, threads report."""
        self.opening.tick(self)
        self.making.tick(self)
        if self.scene is not None and self.scene.rig.update(seconds):
            self.touch(2)
        self.filming.tick(self, seconds)
        self.gallery.tick(self)
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
        """The window drew a frame."""
        self.frames_owed = max(0, self.frames_owed - 1)

    # Looking

    def camera(self) -> ViewCamera | None:
        """The camera of this moment, for the whole viewport at full resolution."""
        if self.scene is None:
            return None
        width, height = self.viewport.pixels
        self.scene.rig.shape(width / height)
        return self.scene.rig.camera((width, height), self.settings.near)

    @property
    def fov(self) -> float:
        """Vertical field of view of what is shown, degrees."""
        if self.scene is None:
            return 0.0
        held = self.scene.rig.held
        return self.scene.rig.fov if held is None else degrees(2 * atan(0.5 * held.height / held.fy))

    def copy_pose(self) -> None:
        """Puts the camera's pose on the clipboard, as one line of JSON."""
        if self.scene is not None:
            self.clipboard.set(pose_to_text(self.scene.rig.matrix, self.fov))
            self.messages.say("The pose is on the clipboard")

    def paste_pose(self, text: str | None = None) -> None:
        """Goes to a pose that was copied (or given as text). ValueError, told plainly, where it is none."""
        if self.scene is not None:
            self.scene.rig.set_matrix(*pose_from_text(self.clipboard.get() if text is None else text))
            self.touch()

    def set(self, **fields: object) -> None:
        """Changes render settings."""
        changed = replace(self.settings, **fields)  # type: ignore[arg-type]
        if changed != self.settings:
            self.settings = changed
            self.touch()

    def cut(self, **fields: object) -> None:
        """Changes what is cut off (settings crop and near), to be undone as one step."""
        if self.scene is not None:
            self.scene.rig.remember()
        self.set(**fields)

    def set_fov(self, degrees: float) -> None:
        """Vertical field of view."""
        if self.scene is not None:
            self.scene.rig.take_over()
            self.scene.rig.fov = min(max(degrees, FOVS[0]), FOVS[1])
            self.touch()

    def pivot_at(self, x: float, y: float) -> bool:
        """Makes the surface under a point of the viewport (window units from its corner) the pivot; False for none."""
        camera = self.camera()
        if camera is None or self.stage is None or self.scene is None or self.scene.rig.bounded:
            return False
        scale = self.viewport.pixels_per_unit
        px, py = x * scale, y * scale
        distance = self.stage.distance_at(camera, self.settings, px, py)
        if distance is None:
            return False
        ray = rays_through(camera, np.array([[px, py]]))[0]
        ray = camera.grid_T_camera[:3, :3] @ (ray / np.linalg.norm(ray))
        self.scene.rig.set_pivot(camera.position + distance * ray)
        self.touch()
        return True
