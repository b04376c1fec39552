"""What the viewer knows about what it shows and where: the open scene, the panels, the viewport."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenepack.editing import NOTHING, EditPreview, Selection
from scenepack.exports.field import Corners
from scenepack.pack import Pack
from viewer.core.annotations import Annotations
from viewer.rendering.camera import ViewCamera

if TYPE_CHECKING:
    from viewer.features.camera.orbit_camera import OrbitCamera
    from viewer.features.film.camera_path import CameraPath

FRAMES_AFTER_EVENT = 3  # imgui needs a frame to see an event and another to draw what follows from it
SCALES = (0.75, 0.85, 1.0, 1.15, 1.3, 1.5, 1.75, 2.0)  # of the interface


@dataclass(frozen=True, eq=False)
class Edits:
    """What was erased of a pack, and what is selected of the rest."""

    removed: Selection = NOTHING
    selected: Selection = NOTHING


@dataclass(eq=False)
class OpenScene:
    """A pack that is shown, or was and is still open."""

    path: Path
    name: str  # what the title bar says
    pack: Pack
    rig: OrbitCamera
    whole: bool = True  # False while it is still being read
    stays: bool = True  # open when another is opened; False for a scene that is being made
    edits: Edits = Edits()
    preview: EditPreview | None = None  # shows them in the pack's atlas; None until something is to be edited
    saved: Selection = NOTHING  # what was erased when it was saved last
    # while another pack is shown: what this one is shown with again
    crop: Corners | None = None  # as in RenderSettings, as the next
    near: float = 0.0
    camera_path: CameraPath | None = None
    annotations: Annotations | None = None  # None: as saved

    @property
    def unsaved(self) -> bool:
        """Whether something was erased that no pack on the disk has."""
        return bool(self.edits.removed.bits) and self.edits.removed is not self.saved


@dataclass
class Interface:
    page: str = "view"  # the one that the rail shows at its usual place; "" for none
    moved: list[str] = field(default_factory=list)  # others, dragged elsewhere: they stay open whatever the rail shows
    over: str = ""  # the one that lies over the picture of a narrow window
    layout: str = ""  # where all of them are docked, as viewer.interface.layout writes it; "" is the usual layout
    layout_reset: bool = False  # it shall be that again
    panels_shown: bool = True
    help_shown: bool = False
    full_screen: bool = False
    v_sync: bool = True
    axes_shown: bool = True  # the gizmo with the grid's axes is in the picture's corner
    language: str = "en"  # a key of viewer.core.language.LANGUAGES
    theme: str = "dark"  # a key of viewer.core.theme.PALETTES
    scale: float = 1.0  # how many times larger than usual all panels are; SCALES

    def shows(self, page: str) -> bool:
        return page in (self.page, self.over) or page in self.moved

    def opens(self, page: str) -> None:
        """Opens a page; at the usual place it takes that of the one before."""
        if not self.shows(page):
            self.page = page

    def closes(self, page: str) -> None:
        self.page = "" if page == self.page else self.page
        self.over = "" if page == self.over else self.over
        self.moved = [other for other in self.moved if other != page]

    def placed(self, page: str, usual: bool) -> None:
        """A page is docked at the usual place, or has been dragged elsewhere."""
        if not usual and page not in self.moved:
            self.moved.append(page)
            self.page = "" if page == self.page else self.page
        elif usual and page in self.moved:
            self.moved.remove(page)
            self.page = page

    def rescale(self, steps: int) -> None:
        nearest = min(range(len(SCALES)), key=lambda i: abs(SCALES[i] - self.scale))
        self.scale = SCALES[min(max(nearest + steps, 0), len(SCALES) - 1)]

    def reset_layout(self) -> None:
        """All pages to their usual place, one of them open."""
        self.page = self.page or next(iter(self.moved), "view")
        self.moved, self.layout, self.layout_reset = [], "", True


class Clipboard:
    """The system's clipboard; a plain variable until a window brings the real one."""

    text = ""


@dataclass
class Viewport:
    """Where the picture is: position and size in window units."""

    x: float = 0.0
    y: float = 0.0
    width: float = 1.0
    height: float = 1.0
    pixels_per_unit: float = 1.0
    camera: ViewCamera | None = field(default=None, compare=False)  # of this frame; None while nothing is open

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height in framebuffer pixels, at least 1."""
        scale = self.pixels_per_unit
        return max(1, round(self.width * scale)), max(1, round(self.height * scale))


def name_of(path: Path) -> str:
    """What a pack is called: its file's or folder's name, or that of the folder around it where it is just "pack"."""
    path = path.resolve()
    name = path.stem if path.suffix.lower() == ".zip" else path.name
    return path.parent.name if name == "pack" and path.parent.name else name
