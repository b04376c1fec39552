"""Draws an export preview: triangles or points with their colours, lit from the camera (shaders/sketch.vert)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from viewer.rendering.camera import ViewCamera
from viewer.rendering.opengl import Program
from viewer.rendering.shader_source import assemble

if TYPE_CHECKING:
    from scenepack.exports.scene import PreviewGeometry

NEAREST = 1e-3  # of the farthest that is shown


class ExportPreviewPicture:
    """Draws preview geometry, which stays on the GPU until another is drawn."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._program = Program(ctx, assemble("sketch.vert"), assemble("sketch.frag"))
        self._geometry: PreviewGeometry | None = None
        self._buffers: list[moderngl.Buffer] = []
        self._array: moderngl.VertexArray | None = None

    def draw(
        self,
        framebuffer: moderngl.Framebuffer,
        geometry: PreviewGeometry,
        camera: ViewCamera,
        ground: tuple[float, float, float],
    ) -> None:
        """Into the lower left corner of `framebuffer`, width × height of the camera. ground: the colour behind it, sRGB."""
        self._take(geometry)
        assert self._array is not None
        position = camera.grid_T_camera[:3, 3]
        farthest = 1.1 * float(np.linalg.norm(geometry.vertices - position, axis=1).max())
        uniforms = {
            "camera_R_grid": np.linalg.inv(camera.grid_T_camera[:3, :3]),
            "camera_position": position,
            "intrinsics": (camera.fx, camera.fy, camera.cx, camera.cy),
            "picture_size": (camera.width, camera.height),
            "depths": (NEAREST * farthest, farthest),
            "orthographic": float(camera.orthographic),
            "point_size": geometry.size,
        }
        self._program.write(uniforms)
        framebuffer.use()
        framebuffer.viewport = (0, 0, camera.width, camera.height)
        framebuffer.depth_mask = True
        framebuffer.clear(*ground, 1.0, 1.0)
        self.ctx.enable_only(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        self._array.render(moderngl.TRIANGLES if len(geometry.faces) else moderngl.POINTS)
        self.ctx.enable_only(moderngl.NOTHING)

    def _take(self, geometry: PreviewGeometry) -> None:
        if geometry is self._geometry:
            return
        self._forget()
        self._geometry = geometry
        places, normals, colours = (
            self.ctx.buffer(np.ascontiguousarray(each).tobytes())
            for each in (geometry.vertices.astype("f4"), geometry.normals.astype("f4"), geometry.colours)
        )
        order = self.ctx.buffer(np.ascontiguousarray(geometry.faces, "i4").tobytes()) if len(geometry.faces) else None
        self._buffers = [places, normals, colours, *([order] if order is not None else [])]
        content = [(places, "3f", "place"), (normals, "3f", "normal"), (colours, "3f1", "colour")]
        self._array = self.ctx.vertex_array(self._program.linked, content, order)

    def _forget(self) -> None:
        if self._array is not None:
            self._array.release()
        for buffer in self._buffers:
            buffer.release()
        self._array, self._buffers, self._geometry = None, [], None

    def release(self) -> None:
        self._forget()
        self._program.release()
