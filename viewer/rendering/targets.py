"""What the canvas draws into, textures of small pictures, and the preview of an export.

A picture of width × height pixels lies in the lower left corner of its texture with one more row of pixels above it and
one more column at its right: what is magnified is blended with the true neighbours at every edge, not with whatever an
earlier picture has left there. Sizes are (width, height) in pixels; boxes x, y, w, h are measured from the top left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import moderngl
import numpy as np

from viewer.rendering.camera import ViewCamera
from viewer.rendering.opengl import Drawing, begin_drawing, free_framebuffer, new_framebuffer
from viewer.rendering.shader_source import assemble

if TYPE_CHECKING:
    from scenepack.exports.scene import Geometry


@dataclass(frozen=True)
class Layer:
    """A rectangle of a texture, drawn over the layers before it."""

    texture: int  # OpenGL name
    uv0: tuple[float, float]  # top left corner in the texture
    uv1: tuple[float, float]  # bottom right corner in the texture
    box: tuple[float, float, float, float]  # x0, y0, x1, y1 on the viewport, 0 … 1 from the top left
    opacity: float = 1.0


Box = tuple[int, int, int, int]


class Sheet:
    """Small pictures side by side in one array, in square cells of `cell` pixels, `columns` a row."""

    def __init__(self, cell: int, columns: int, rows: int) -> None:
        self.cell, self.columns = cell, columns
        self.sheet = np.zeros((rows * cell, columns * cell, 3), np.uint8)
        self.boxes: dict[int, Box] = {}  # x, y, width, height by index of each picture that has arrived

    def put(self, index: int, picture: np.ndarray) -> None:
        """Stores a picture, uint8 [h, w, 3], cut to `cell` pixels a side. Any thread may call it."""
        picture = picture[: self.cell, : self.cell]
        height, width = picture.shape[:2]
        x, y = index % self.columns * self.cell, index // self.columns * self.cell
        self.sheet[y : y + height, x : x + width] = picture
        self.boxes[index] = (x, y, width, height)

    def uv(self, index: int) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Where a picture lies on the sheet, its upper left and lower right corner, 0 … 1; None while it is not there."""
        if index not in self.boxes:
            return None
        height, width = self.sheet.shape[:2]
        x, y, w, h = self.boxes[index]
        return (x / width, y / height), ((x + w) / width, (y + h) / height)


MARGIN = 1  # pixels above and at the right of each picture


def with_margin(camera: ViewCamera) -> ViewCamera:
    return camera.part(0, -MARGIN, camera.width + MARGIN, camera.height + MARGIN)


class Target:
    """A texture to draw into, grown as needed; "f1" is 8 bit, "f4" float32.

    Textures that it no longer needs go to `retired` (see Canvas.sweep); None: they are freed at once.
    """

    def __init__(self, ctx: moderngl.Context, retired: list[moderngl.Texture] | None = None, dtype: str = "f1") -> None:
        self.ctx, self.size, self.retired, self.dtype = ctx, (0, 0), retired, dtype
        self.framebuffer: moderngl.Framebuffer | None = None

    def fit(self, width: int, height: int) -> moderngl.Framebuffer:
        """A framebuffer of at least this size. UserError where the driver refuses one."""
        if self.framebuffer is None or self.size[0] < width or self.size[1] < height:
            self.release()
            self.framebuffer, self.size = new_framebuffer(self.ctx, width, height, self.dtype), (width, height)
            self.texture.repeat_x = self.texture.repeat_y = False
        return self.framebuffer

    @property
    def texture(self) -> moderngl.Texture:
        assert self.framebuffer is not None
        return self.framebuffer.color_attachments[0]  # type: ignore[return-value]

    def release(self) -> None:
        if self.framebuffer is not None:
            if self.retired is not None:
                self.retired.append(self.texture)
            free_framebuffer(self.framebuffer, textures=self.retired is None)
        self.framebuffer, self.size = None, (0, 0)

    def layer(self, size: tuple[int, int], part: Box | None = None) -> Layer:
        """What draws a picture of `size`, or of its `part` what lies inside the part's outermost pixels' centres."""
        (tw, th), (width, height) = self.size, size
        x0, y0, x1, y1 = 0.0, 0.0, float(width), float(height)
        if part is not None:  # beyond these centres it would be blended with what is not drawn yet
            x, y, w, h = part
            x0, y0, x1, y1 = x + 0.5, max(y + 0.5, 0.0), min(x + w - 0.5, x1), y + h - 0.5
        uv0, uv1 = (x0 / tw, (height - y0) / th), (x1 / tw, (height - y1) / th)
        return Layer(self.texture.glo, uv0, uv1, (x0 / width, y0 / height, x1 / width, y1 / height))


class Difference:
    """Subtracts two layers; see shaders/difference.frag."""

    def __init__(self, ctx: moderngl.Context, retired: list[moderngl.Texture]) -> None:
        self.ctx, self._target = ctx, Target(ctx, retired)
        self._drawing = Drawing(ctx, assemble("fullscreen.vert"), assemble("difference.frag"))

    def draw(self, a: Layer, b: Layer, size: tuple[int, int], gain: float) -> Layer:
        """The layer that shows |a - b| · gain on the whole viewport of `size` pixels."""
        begin_drawing(self._target.fit(*size), (0, 0, *size))
        for unit, (name, layer) in enumerate((("a", a), ("b", b))):
            self.ctx.external_texture(layer.texture, (1, 1), 4, 0, "f1").use(unit)
            self._drawing.linked[f"picture_{name}"] = unit
            self._drawing.write({f"box_{name}": layer.box, f"part_{name}": (*layer.uv0, *layer.uv1)})
        self._drawing.write({"target_size": size, "gain": gain})
        self._drawing.draw(3)
        return self._target.layer(size)

    def release(self) -> None:
        self._target.release()
        self._drawing.release()


# --- The preview of an export: triangles or points with their colours, lit from the camera (shaders/sketch.vert) ---

NEAREST = 1e-3  # of the farthest that is shown
CORNER = np.dtype([("place", "f4", 3), ("normal", "f4", 3), ("colour", "u1", 3)])  # one behind the other, packed


class ExportPreviewPicture:
    """Draws preview geometry, which stays on the GPU until another is drawn."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._on_gpu: tuple[Geometry, Drawing] | None = None

    def draw(
        self,
        framebuffer: moderngl.Framebuffer,
        geometry: Geometry,
        camera: ViewCamera,
        ground: tuple[float, float, float],
    ) -> None:
        """Into the lower left corner of `framebuffer`, width × height of the camera. ground: the colour behind it, sRGB."""
        if self._on_gpu is None or self._on_gpu[0] is not geometry:
            self._upload(geometry)
        assert self._on_gpu is not None
        drawing, position = self._on_gpu[1], camera.position
        farthest = 1.1 * float(np.linalg.norm(geometry.vertices - position, axis=1).max())
        drawing.write({
            "camera_R_grid": np.linalg.inv(camera.grid_T_camera[:3, :3]),
            "camera_position": position,
            "intrinsics": (camera.fx, camera.fy, camera.cx, camera.cy),
            "picture_size": (camera.width, camera.height),
            "depths": (NEAREST * farthest, farthest),
            "orthographic": float(camera.orthographic),
            "point_size": geometry.point_size,
        })  # fmt: skip
        begin_drawing(framebuffer, (0, 0, camera.width, camera.height))
        framebuffer.depth_mask = True
        framebuffer.clear(*ground, 1.0, 1.0)
        self.ctx.enable_only(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        drawing.draw(kind=moderngl.TRIANGLES if len(geometry.faces) else moderngl.POINTS)
        self.ctx.enable_only(moderngl.NOTHING)

    def _upload(self, geometry: Geometry) -> None:
        self.release()
        order = geometry.faces.ravel() if len(geometry.faces) else slice(None)
        corners = np.empty(len(geometry.vertices[order]), CORNER)
        corners["place"], corners["normal"] = geometry.vertices[order], geometry.normals[order]
        corners["colour"] = geometry.colours[order]
        shaders = assemble("sketch.vert"), assemble("sketch.frag")
        self._on_gpu = geometry, Drawing(self.ctx, *shaders, corners, "3f 3f 3f1", "place", "normal", "colour")

    def release(self) -> None:
        if self._on_gpu is not None:
            self._on_gpu[1].release()
        self._on_gpu = None
