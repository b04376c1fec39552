"""OpenGL canvas of the open pack: quick pictures while the camera moves, full ones in tiles while it rests.

Features ask it for figures and stills; panels draw its layers. Only the main thread calls it. Textures are as large as the
viewport; quick pictures use their lower left corner, so that a change of scale allocates nothing. The picture is drawn while the
panels are built, so that both show the same camera.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import moderngl
import numpy as np

from scenepack.pack import Pack
from viewer.rendering import targets
from viewer.rendering.camera import ViewCamera
from viewer.rendering.dynamic_resolution import DynamicResolution, tiles
from viewer.rendering.layers import depth_along_axis
from viewer.rendering.opengl import GpuClock, free_framebuffer, new_framebuffer, read_pixels
from viewer.rendering.renderer import Renderer
from viewer.rendering.settings import RenderSettings
from viewer.rendering.targets import MARGIN, Box, Layer, Sheet, with_margin

if TYPE_CHECKING:
    from scenepack.exports.scene import Geometry

ARRIVING_S = 0.03  # of each frame, for a pack's way to the GPU
REST_S = 0.12  # this long without a change, and the full picture is begun
BLEND_S = 0.08  # in which a tile of it appears over the quick picture, so that nothing jumps
SHEET = "sheet"  # the image that is the sheet of thumbnails
HALVINGS = 2  # its mipmaps; cells are powers of two, so that neighbours do not mix at these sizes


class Canvas:
    """Draws the open pack. ctx: of the window, or an offscreen one."""

    def __init__(self, ctx: moderngl.Context, retired: list[moderngl.Texture] | None = None) -> None:
        self.ctx = ctx
        self.renderer: Renderer | None = None
        self._coming: Renderer | None = None  # a finer one, shown once all of it has arrived
        self._retired = [] if retired is None else retired
        self._quick, self._full, self._still = (targets.Target(ctx, self._retired) for _ in range(3))
        self._wanted: tuple[object, ...] = ()  # what makes two pictures the same one
        self._changed_at = 0.0
        self._tiles: list[Box] | None = None  # still to draw, margin included; None: not begun
        self._done: list[tuple[Box, float, float, float]] = []  # and when each was drawn; how long that took, see below
        self._size = (0, 0)  # of the full picture, pixels
        self._blending = False
        self.layers: list[Layer] = []
        self.quick: Layer | None = None  # all of the picture, at the scale of movements
        self.other: Canvas | None = None  # another pack under the same camera
        self.difference: Layer | None = None
        self._difference: targets.Difference | None = None
        self._images: dict[str, tuple[np.ndarray, moderngl.Texture]] = {}
        self._on_sheet: set[int] = set()  # pictures of the sheet that are in its texture
        self._preview_picture = targets.ExportPreviewPicture(ctx)
        self.clock = GpuClock(ctx)
        self.rest_s, self.blend_s = REST_S, BLEND_S
        self.scene_ms = 0.0  # of what was drawn last, by the wall clock around finish()
        self.gpu_ms: float | None = None  # of the same, by the GPU's own clock
        self.picture_ms = 0.0  # of the whole picture that is shown, all its tiles together
        self.picture_gpu_ms: float | None = None  # likewise, by the GPU's own clock
        self.drawn_size = (0, 0)  # pixels of the picture that is shown
        # That this frame took to draw all of its pictures, ms: by the wall clock, and by the GPU's; see viewer.app.frame
        self.drawn: tuple[float, float | None] | None = None

    # Packs and pixels

    def show(self, pack: Pack | None) -> None:
        """Uploads another pack. UserError, with the old one kept, where it does not fit."""
        self._drop_coming()
        renderer = None if pack is None else Renderer(self.ctx, pack, at_once=False)
        if self.renderer is not None:
            self.renderer.release()
        self.renderer = renderer
        self.forget()

    def refine(self, pack: Pack) -> None:
        """Uploads a finer version of the open pack and shows it once it is complete."""
        coming = Renderer(self.ctx, pack, at_once=False)
        self._drop_coming()
        self._coming = coming

    @property
    def refines(self) -> bool:
        """Whether a finer version of the open pack is on its way to the GPU."""
        return self._coming is not None

    def _drop_coming(self) -> None:
        if self._coming is not None:
            self._coming.release()
        self._coming = None

    def _receive(self, camera: ViewCamera) -> None:
        """Goes on with what is on its way to the GPU, what lies close to the camera first."""
        assert self.renderer is not None
        (self._coming or self.renderer).see_first(camera)
        if self._coming is not None:
            if self._coming.arrive(ARRIVING_S):
                self.renderer.release()
                self.renderer, self._coming = self._coming, None
                self._wanted = ()
        elif self.renderer.arriving:
            self.renderer.arrive(ARRIVING_S)
            self._wanted = ()  # more is to be seen now

    def _receive_all(self) -> Renderer:
        """What draws the whole pack, at its finest: what is still on its way to the GPU is waited for."""
        finest = self._coming or self.renderer
        assert finest is not None
        finest.arrive()
        return finest

    def rewrite(self, numbers: Sequence[int], *, redraw: bool) -> None:
        """See Renderer.rewrite. redraw: and draws the picture anew."""
        if self.renderer is not None:
            self.renderer.rewrite(numbers)
            self._wanted = () if redraw else self._wanted

    def show_other(self, pack: Pack | None) -> None:
        """Uploads a second pack to compare with; None removes it."""
        other = None
        if pack is not None:
            other = Canvas(self.ctx, self._retired)
            other.rest_s, other.blend_s = self.rest_s, self.blend_s
            other.show(pack)
        if self.other is not None:
            self.other.release()
        self.other = other

    def image(self, name: str, pixels: np.ndarray) -> int:
        """OpenGL name of the texture `name` with `pixels` (uint8 [h, w, 3]); uploaded again when they change."""
        return self._texture(name, pixels).glo

    def sheet(self, sheet: Sheet) -> int:
        """OpenGL name of the texture with all that has arrived on a sheet."""
        if SHEET not in self._images or self._images[SHEET][0] is not sheet.sheet:
            self._on_sheet = set()
        texture = self._texture(SHEET, sheet.sheet)
        if arrived := set(sheet.boxes) - self._on_sheet:
            for x, y, width, height in (sheet.boxes[index] for index in arrived):
                pixels = np.ascontiguousarray(sheet.sheet[y : y + height, x : x + width])
                texture.write(pixels, (x, y, width, height), alignment=1)
            self._on_sheet |= arrived
            texture.build_mipmaps(0, HALVINGS)
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        return texture.glo

    def _texture(self, name: str, pixels: np.ndarray) -> moderngl.Texture:
        if name not in self._images or self._images[name][0] is not pixels:
            self.drop_image(name)
            texture = self.ctx.texture((pixels.shape[1], pixels.shape[0]), 3, pixels.tobytes(), alignment=1)
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self._images[name] = (pixels, texture)
        return self._images[name][1]

    def drop_image(self, name: str) -> None:
        if name in self._images:
            self._retired.append(self._images.pop(name)[1])

    def subtract(self, picture: Layer, other: Layer, size: tuple[int, int], gain: float) -> None:
        """Sets `difference` to |picture - other| · gain, at `size` (width, height in pixels)."""
        if self._difference is None:
            self._difference = targets.Difference(self.ctx, self._retired)
        self.difference = self._difference.draw(picture, other, size, gain)

    def depth(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """Mean depth along the optical axis, grid units, float32 [height, width]; 0 for nothing."""
        settings = replace(settings, marcher="exact", mode="depth", raw=True, samples=1)
        return depth_along_axis(self.raw(camera, settings), camera, self._receive_all().pack)

    def draw_export_preview(
        self, geometry: Geometry, camera: ViewCamera, ground: tuple[float, float, float]
    ) -> np.ndarray:
        """A picture of what an export would write, uint8 [height, width, 3], over the colour `ground` (sRGB, 0 … 1)."""
        framebuffer = self._still.fit(camera.width, camera.height)
        self._preview_picture.draw(framebuffer, geometry, camera, ground)
        return read_pixels(framebuffer, camera.width, camera.height)

    def drop_export_preview(self) -> None:
        self._preview_picture.release()

    def raw(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """The picture unrounded, or raw values, of the whole pack, float32 [height, width, 4]; see layers."""
        renderer = self._receive_all()
        framebuffer = new_framebuffer(self.ctx, camera.width, camera.height, "f4")
        try:
            renderer.render(framebuffer, camera, settings)
            return read_pixels(framebuffer, camera.width, camera.height, 4, "f4")
        finally:
            free_framebuffer(framebuffer)

    def snapshot(self, camera: ViewCamera, settings: RenderSettings) -> np.ndarray:
        """The picture, uint8 [height, width, 3]; waits until the whole pack is uploaded."""
        renderer = self._receive_all()
        framebuffer = self._still.fit(camera.width, camera.height)
        renderer.render(framebuffer, camera, settings)
        return read_pixels(framebuffer, camera.width, camera.height)

    @property
    def gpu_name(self) -> str:
        return str(self.ctx.info.get("GL_RENDERER", "unknown"))

    @property
    def gpu_bytes_by_use(self) -> dict[str, int]:
        """Texture memory in bytes, by what it is for; what takes none is left out."""
        uses = {
            "Pack": self.renderer.gpu_bytes() if self.renderer is not None else 0,
            "Other pack": self.other.gpu_bytes if self.other is not None else 0,
            "Pictures": sum(4 * target.size[0] * target.size[1] for target in (self._quick, self._full, self._still)),
            "Photographs": sum(t.width * t.height * 4 for _, t in self._images.values()),
        }
        return {use: size for use, size in uses.items() if size}

    @property
    def gpu_bytes(self) -> int:
        return sum(self.gpu_bytes_by_use.values())

    # Drawing

    def follow(
        self, camera: ViewCamera | None, settings: RenderSettings, resolution: DynamicResolution, *, anew: bool = False
    ) -> bool:
        """Draws a quick picture if `layers` show another camera or other settings, or if `anew`. True if it drew."""
        if self.renderer is None or camera is None:
            self.layers = []
            return False
        self._receive(camera)
        wanted = (camera.key, settings, resolution.rest_scale)
        if wanted == self._wanted and not anew:
            return False
        self._wanted, self._changed_at, self._tiles = wanted, time.monotonic(), None
        self._draw_quick(camera, settings, resolution)
        return True

    def sharpen(self, camera: ViewCamera | None, settings: RenderSettings, resolution: DynamicResolution) -> bool:
        """Draws the next tile of the full picture after `rest_s` without a change; call it after follow(). True if it drew."""
        if self.renderer is None or camera is None or not self._wanted:
            return False
        if self._tiles == []:
            self._blend()
            return False
        if self._tiles is None and time.monotonic() - self._changed_at < self.rest_s:
            return False
        self._draw_tile(camera, settings, resolution)
        self._blend()
        return True

    def sweep(self) -> None:
        """Frees textures that are not needed. Call before a frame's panels are built: lists built already may name them."""
        while self._retired:
            self._retired.pop().release()

    def forget(self) -> None:
        """Begins anew with the next draw, after one that failed."""
        self._wanted, self._tiles, self.layers, self.quick, self.difference = (), None, [], None, None
        self._blending = False

    @property
    def pending(self) -> bool:
        """Whether the full picture is not there yet."""
        if self.renderer is None:
            return False
        drawing = bool(self._wanted) and self._tiles != []
        return self.renderer.arriving or self._coming is not None or drawing or self._blending

    @property
    def blending(self) -> bool:
        """Whether a tile is appearing at this moment: the next frame shows more of it, and nothing is to be drawn for it."""
        return self.renderer is not None and self._blending and self._tiles == []

    def _draw_quick(self, camera: ViewCamera, settings: RenderSettings, resolution: DynamicResolution) -> None:
        size = _scaled(camera, resolution.moving_scale)
        drawn = with_margin(camera.resized(*size))
        whole = with_margin(camera)
        target = self._quick.fit(whole.width, whole.height)
        self._timed(target, drawn, settings, (0, 0))
        self.picture_ms, self.picture_gpu_ms = self.scene_ms, self.gpu_ms
        resolution.moved(self.scene_ms, drawn.width * drawn.height)
        self.drawn_size = size
        self.quick = self._quick.layer(size)
        self.layers, self._blending = [self.quick], False
        if size == _scaled(camera, resolution.rest_scale):
            self._tiles = []

    def _draw_tile(self, camera: ViewCamera, settings: RenderSettings, resolution: DynamicResolution) -> None:
        size = _scaled(camera, resolution.rest_scale)
        whole = with_margin(camera.resized(*size))
        if self._tiles is None:
            self._tiles, self._done = tiles(whole.width, whole.height, resolution.tile_side()), []
        target = self._full.fit(whole.width, whole.height)
        x, y, w, h = self._tiles.pop(0)
        self._timed(target, whole.part(x, y, w, h), settings, (x, whole.height - y - h))
        resolution.measured(self.scene_ms, w * h)
        self._done.append(((x, y - MARGIN, w, h), time.monotonic(), self.scene_ms, self.gpu_ms or 0.0))
        self._size, self._blending = size, True
        if not self._tiles:
            self.drawn_size, self.picture_ms = size, sum(scene_ms for *_, scene_ms, _ in self._done)
            self.picture_gpu_ms = None if self.gpu_ms is None else sum(gpu_ms for *_, gpu_ms in self._done)

    def _blend(self) -> None:
        """Puts the tiles over the quick picture as far as they have appeared; at last all of it: tiles end at pixels' centres."""
        if not self._blending:
            return
        assert self.quick is not None
        now = time.monotonic()

        def shown(layer: Layer, drawn: float) -> Layer:
            age = (now - drawn) / self.blend_s if self.blend_s > 0 else 1.0
            return replace(layer, opacity=min(age, 1.0))

        tiles = [shown(self._full.layer(self._size, box), drawn) for box, drawn, *_ in self._done]
        self.layers = [self.quick, *tiles]
        if not self._tiles:
            whole = shown(self._full.layer(self._size), self._done[-1][1])
            self._blending = whole.opacity < 1.0
            self.layers = [*self.layers, whole] if self._blending else [whole]

    def _timed(self, target: moderngl.Framebuffer, camera: ViewCamera, settings: RenderSettings, corner) -> None:
        renderer = self.renderer
        assert renderer is not None
        self.gpu_ms, self.scene_ms = self.clock.time(lambda: renderer.render(target, camera, settings, corner))

    def release(self) -> None:
        self.show_other(None)
        self._drop_coming()
        for name in list(self._images):
            self.drop_image(name)
        targets = self._quick, self._full, self._still
        for part in (self._preview_picture, self._difference, *targets, self.renderer):
            if part is not None:
                part.release()
        self.renderer = None
        self.layers, self.difference = [], None

    def close(self) -> None:
        """As release(), and what was left to be freed as well: nothing is drawn any more."""
        self.release()
        self.sweep()


def _scaled(camera: ViewCamera, scale: float) -> tuple[int, int]:
    return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
