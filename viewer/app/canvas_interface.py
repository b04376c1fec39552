"""Interface between viewer features and the OpenGL canvas.

viewer.window.canvas implements it. Features ask it for figures and stills; panels draw its layers. Only the main thread calls it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from scenepack.pack import Pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.dynamic_resolution import DynamicResolution
from viewer.rendering.settings import RenderSettings

if TYPE_CHECKING:
    from scenepack.exports.export_preview import PreviewGeometry


@dataclass(frozen=True)
class Layer:
    """A rectangle of a texture, drawn over the layers before it."""

    texture: int  # OpenGL name
    uv0: tuple[float, float]  # top left corner in the texture
    uv1: tuple[float, float]  # bottom right corner in the texture
    box: tuple[float, float, float, float]  # x0, y0, x1, y1 on the viewport, 0 … 1 from the top left
    opacity: float = 1.0


@dataclass(frozen=True)
class Drawn:
    """Time that a frame took to draw the picture, or both pictures of a comparison."""

    scene_ms: float  # wall clock, around finish()
    gpu_ms: float | None  # the GPU's own timer; None where it is unreliable


class Sheet(Protocol):
    """Small pictures side by side in one array."""

    sheet: np.ndarray  # uint8 [rows, columns, 3]
    boxes: dict[int, tuple[int, int, int, int]]  # x, y, width, height by index of each picture that has arrived


class Picture(Protocol):
    """The picture of one pack: a quick one while the camera moves, a full one tile by tile while it rests."""

    layers: list[Layer]  # what shows the pack now
    quick: Layer | None  # the quick picture; None before the first
    scene_ms: float  # of the last drawing, wall clock
    gpu_ms: float | None  # of the last drawing, GPU timer; None where it is unreliable
    picture_ms: float  # of all tiles of the full picture, wall clock
    picture_gpu_ms: float | None
    drawn_size: tuple[int, int]  # width, height, pixels

    @property
    def pending(self) -> bool:
        """Whether the full picture is not there yet."""
        ...

    def follow(
        self, camera: ViewCamera | None, settings: RenderSettings, resolution: DynamicResolution, *, anew: bool = False
    ) -> bool:
        """Draws a quick picture if `layers` show another camera or other settings, or if `anew`. True if it drew."""
        ...

    def sharpen(self, camera: ViewCamera | None, settings: RenderSettings, resolution: DynamicResolution) -> bool:
        """Draws the next tile of the full picture once nothing has changed for a moment. True if it drew.

        Call it after follow(), with the same arguments.
        """
        ...


class CanvasInterface(Picture, Protocol):
    """The picture of the open pack, a second one to compare with, and textures for the panels."""

    difference: Layer | None  # |picture - other| as `subtract` drew it last; None where nothing is subtracted
    drawn: Drawn | None  # what this frame drew

    @property
    def other(self) -> Picture | None:
        """The pack that is compared with, under the same camera."""
        ...

    # Packs

    def preallocate(self, pack: Pack | None) -> None:
        """Begins to allocate textures for a pack that is still being read; None gives them up."""

    def show(self, pack: Pack | None) -> None:
        """Uploads another pack. UserError, with the old one kept, where it does not fit."""

    def refine(self, pack: Pack) -> None:
        """Uploads a finer version of the open pack and shows it once it is complete."""

    def show_other(self, pack: Pack | None) -> None:
        """Uploads a second pack to compare with; None removes it."""

    # Pixels

    def distance_at(self, camera: ViewCamera, settings: RenderSettings, x: float, y: float) -> float | None:
        """Distance (grid units) along the ray through pixel (x, y) to the surface; None where there is none."""

    def snapshot(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """The picture, uint8 [height, width, 3]; waits until the whole pack is uploaded."""
        ...

    def raw(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """Raw values or counts of the whole pack, float32 [height, width, 4]; see viewer.rendering.layers."""
        ...

    def ray_counts(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """Samples per ray, float32 [height, width, 3], for `settings` with counts."""
        ...

    # What panels draw with

    def subtract(self, picture: Layer, other: Layer, size: tuple[int, int], gain: float) -> None:
        """Sets `difference` to |picture - other| · gain, at `size` (width, height in pixels)."""

    def image(self, name: str, pixels: np.ndarray) -> int:
        """OpenGL name of the texture `name` with `pixels` (uint8 [h, w, 3]); uploaded again when they change."""
        ...

    def drop_image(self, name: str) -> None:
        """Frees such a texture, if there is one."""

    def draw_export_preview(
        self, geometry: PreviewGeometry, camera: ViewCamera, ground: tuple[float, float, float]
    ) -> np.ndarray:
        """A picture of what an export would write, uint8 [height, width, 3], over the colour `ground` (sRGB, 0 … 1)."""
        ...

    def drop_export_preview(self) -> None:
        """Frees the GPU memory of `draw_export_preview`."""

    def sheet(self, sheet: Sheet) -> int:
        """OpenGL name of the texture with all that has arrived on a sheet."""
        ...

    def forget(self) -> None:
        """Starts over with the next frame, after one that failed."""

    # Figures

    @property
    def card(self) -> str:
        """The graphics card's name."""
        ...

    @property
    def clock_problem(self) -> str:
        """Why the GPU's timer is unreliable; "" where it is not."""
        ...

    @property
    def gpu_bytes_by_use(self) -> Mapping[str, int]:
        """Texture memory in bytes, by what it is for; what takes none is left out."""
        ...

    @property
    def gpu_bytes(self) -> int:
        """Texture memory in use."""
        ...
