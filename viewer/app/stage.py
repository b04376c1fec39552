"""What draws packs, as those see it who use it: features take figures and stills from it, panels put its layers on screen.

viewer.window.canvas implements it with OpenGL; nothing here does. Only the main thread calls it.
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
    """A piece of texture to draw: texture (OpenGL name), its part uv0 … uv1 (top left, bottom right), and where on the
    viewport it belongs, box x0, y0, x1, y1 in 0 … 1 from the top left. opacity: 0 … 1, over the layers before it.
    """

    texture: int
    uv0: tuple[float, float]
    uv1: tuple[float, float]
    box: tuple[float, float, float, float]
    opacity: float = 1.0


@dataclass(frozen=True)
class Drawn:
    """What a frame drew of the picture, or of both pictures of a comparison: milliseconds by the wall clock around finish(),
    and by the card's own clock, None where that is not to be trusted.
    """

    scene_ms: float
    gpu_ms: float | None


class Sheet(Protocol):
    """Small pictures side by side. sheet: uint8 [rows, columns, 3]. boxes: by index, x, y, width, height of each picture
    whose pixels are there; it grows.
    """

    sheet: np.ndarray
    boxes: dict[int, tuple[int, int, int, int]]


class Picture(Protocol):
    """One pack under the app's camera: quick while things move, sharpened tile by tile while they rest.

    layers: what shows it now. quick: all of it at the scale of movements, None before the first. scene_ms, gpu_ms: of what
    was drawn last, by the wall clock and by the card's own (None where that is not to be trusted); picture_ms,
    picture_gpu_ms: likewise of the whole picture, all its tiles together. drawn_size: width, height in pixels.
    """

    layers: list[Layer]
    quick: Layer | None
    scene_ms: float
    gpu_ms: float | None
    picture_ms: float
    picture_gpu_ms: float | None
    drawn_size: tuple[int, int]

    @property
    def pending(self) -> bool:
        """Whether the full picture is not there yet."""
        ...

    def follow(
        self, camera: ViewCamera | None, settings: RenderSettings, resolution: DynamicResolution, *, anew: bool = False
    ) -> bool:
        """Draws a quick picture if `layers` do not show this camera and these settings, or if it shall be drawn `anew`; True
        where it drew one.
        """
        ...

    def sharpen(self, camera: ViewCamera | None, settings: RenderSettings, resolution: DynamicResolution) -> bool:
        """Draws the next tile of the full picture, once nothing has changed for a moment; True where it drew one. Tiles
        appear by and by, over the quick picture.

        Call it after follow(), with the same arguments.
        """
        ...


class Stage(Picture, Protocol):
    """The picture of the open pack, and all else that is drawn on the card.

    difference: |picture - other| as `subtract` drew it last, None where nothing is subtracted. drawn: by this frame.
    """

    difference: Layer | None
    drawn: Drawn | None

    @property
    def other(self) -> Picture | None:
        """The pack that is compared with, under the same camera."""
        ...

    # Packs

    def preallocate(self, pack: Pack | None) -> None:
        """Begins to allocate textures for a pack that is still being read; None gives them up."""

    def show(self, pack: Pack | None) -> None:
        """Puts another pack on the card; raises UserError and keeps the old one where it does not fit."""

    def refine(self, pack: Pack) -> None:
        """Puts a finer version of the pack that is shown on the card, and shows it once all of it is there."""

    def show_other(self, pack: Pack | None) -> None:
        """Puts a second pack on the card, to compare with; None takes it off."""

    # Asking for pixels

    def distance_at(self, camera: ViewCamera, settings: RenderSettings, x: float, y: float) -> float | None:
        """Distance (grid units) along the ray through pixel (x, y) to the surface; None where there is none."""

    def snapshot(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """The picture of the whole pack, uint8 [height, width, 3]; what of it is on its way to the card is waited for."""
        ...

    def raw(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """What `settings` with raw or counts give of the whole pack, float32 [height, width, 4]; see viewer.rendering.layers."""
        ...

    def ray_counts(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """What `settings` with counts give, float32 [height, width, 3]."""
        ...

    # What panels draw with

    def subtract(self, picture: Layer, other: Layer, size: tuple[int, int], gain: float) -> None:
        """Sets `difference` to |picture - other| · gain, at `size` (width, height in pixels)."""

    def image(self, name: str, pixels: np.ndarray) -> int:
        """OpenGL name of a texture that holds `pixels` (uint8 [h, w, 3]); made anew when other pixels are given."""
        ...

    def drop_image(self, name: str) -> None:
        """Frees such a texture, if there is one."""

    def draw_export_preview(
        self, geometry: PreviewGeometry, camera: ViewCamera, ground: tuple[float, float, float]
    ) -> np.ndarray:
        """What an export would write, uint8 [height, width, 3], before the colour `ground` (sRGB, 0 … 1)."""
        ...

    def drop_export_preview(self) -> None:
        """Frees what is kept on the card for `draw_export_preview`."""

    def sheet(self, sheet: Sheet) -> int:
        """OpenGL name of the texture with all that has arrived on a sheet."""
        ...

    def forget(self) -> None:
        """Begins anew with the next frame, after one that failed."""

    # Figures

    @property
    def card(self) -> str:
        """The graphics card's name."""
        ...

    @property
    def clock_problem(self) -> str:
        """Why the card's own clock is not to be trusted; "" where it is."""
        ...

    @property
    def gpu_bytes_by_use(self) -> Mapping[str, int]:
        """Texture memory in bytes, by what it is for; what takes none is left out."""
        ...

    @property
    def gpu_bytes(self) -> int:
        """Texture memory in use."""
        ...
