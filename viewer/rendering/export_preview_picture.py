"""Draws an export preview: triangles or points with their colours, lit from the camera (shaders/sketch.vert)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from viewer.rendering.camera import ViewCamera
from viewer.rendering.opengl import Drawing
from viewer.rendering.shader_source import assemble

if TYPE_CHECKING:
    from scenepack.exports.scene import Geometry

NEAREST = 1e-3  # of the farthest that is shown
CORNER = np.dtype([("place", "f4", 3), ("normal", "f4", 3), ("colour", "u1", 3)])  # one behind the other, packed


class ExportPreviewPicture:
    """Draws preview geometry, which stays on the GPU until another is drawn."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._geometry: Geometry | None = None
        self._buffer: moderngl.Buffer | None = None
        self._drawing: Drawing | None = None

    def draw(
        self,
        framebuffer: moderngl.Framebuffer,
        geometry: Geometry,
        camera: ViewCamera,
        ground: tuple[float, float, float],
    ) -> None:
        """Into the lower left corner of `framebuffer`, width × height of the camera. ground: the colour behind it, sRGB."""
        drawing = self._take(geometry)
        position = camera.grid_T_camera[:3, 3]
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
        framebuffer.use()
        framebuffer.viewport = (0, 0, camera.width, camera.height)
        framebuffer.depth_mask = True
        framebuffer.clear(*ground, 1.0, 1.0)
        self.ctx.enable_only(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        drawing.draw(kind=moderngl.TRIANGLES if len(geometry.faces) else moderngl.POINTS)
        self.ctx.enable_only(moderngl.NOTHING)

    def _take(self, geometry: Geometry) -> Drawing:
        if geometry is self._geometry and self._drawing is not None:
            return self._drawing
        self.release()
        order = geometry.faces.ravel() if len(geometry.faces) else slice(None)
        corners = np.empty(len(geometry.vertices[order]), CORNER)
        corners["place"], corners["normal"] = geometry.vertices[order], geometry.normals[order]
        corners["colour"] = geometry.colours[order]
        self._geometry, self._buffer = geometry, self.ctx.buffer(corners.tobytes())
        content = [(self._buffer, "3f 3f 3f1", "place", "normal", "colour")]
        self._drawing = Drawing(self.ctx, assemble("sketch.vert"), assemble("sketch.frag"), content)
        return self._drawing

    def release(self) -> None:
        for thing in (self._drawing, self._buffer):
            if thing is not None:
                thing.release()
        self._geometry = self._buffer = self._drawing = None
