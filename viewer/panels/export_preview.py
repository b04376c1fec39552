"""The picture of what an export would write, in the dialog that asks for it: dragged, it turns the scene's camera."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.canvas_interface import CanvasInterface
from viewer.panels import theme
from viewer.panels.widgets import hint, px

IMAGE = "export preview"
FINER = 2  # pixels drawn along each side of one that is shown: edges become smooth


class PreviewPane:
    """Keeps the picture while neither camera nor geometry changes."""

    def __init__(self) -> None:
        self._of: tuple[object, ...] = ()
        self._pixels = None
        self._held = False  # by the mouse

    def show(self, app: App, canvas: CanvasInterface, width: float, height: float) -> None:
        """width, height: of the picture, in window units; a line of text comes below it."""
        preview, scene = app.exporting.preview, app.scene
        if preview is None or scene is None:
            return
        at = imgui.get_cursor_screen_pos()
        imgui.dummy(ImVec2(width, height))
        self._turn(app, height)
        draw, corner = imgui.get_window_draw_list(), ImVec2(at.x + width, at.y + height)
        draw.add_rect_filled(at, corner, theme.packed(theme.BASE), px(6))
        if preview.geometry is not None:
            density = FINER * imgui.get_io().display_framebuffer_scale.x
            camera = scene.rig.camera((round(density * width), round(density * height)))
            of = (preview.geometry, camera.grid_T_camera.tobytes(), camera.fx, camera.width, camera.height, theme.BASE)
            if of != self._of:
                ground = theme.rgb(theme.BASE)
                self._pixels = canvas.draw_export_preview(preview.geometry, camera, (ground.x, ground.y, ground.z))
                self._of = of
            assert self._pixels is not None
            texture = imgui.ImTextureRef(canvas.image(IMAGE, self._pixels))
            dim = 0.35 if preview.error else 1.0
            shade = theme.packed("#ffffff", dim)
            draw.add_image_rounded(texture, at, corner, ImVec2(0, 0), ImVec2(1, 1), shade, px(6))
        if preview.working:
            low = ImVec2(at.x + width * preview.share, corner.y)
            draw.add_rect_filled(ImVec2(at.x, corner.y - px(3)), low, theme.packed(theme.ACCENT))
        hint(_told(app), theme.WARN if preview.error and not preview.working else theme.FAINT)

    def drop(self, canvas: CanvasInterface) -> None:
        """Frees what it holds on the card."""
        if self._pixels is not None:
            canvas.drop_image(IMAGE)
            canvas.drop_export_preview()
        self._of, self._pixels = (), None

    def _turn(self, app: App, height: float) -> None:
        """What the mouse does on the picture: it orbits, and the wheel moves closer."""
        assert app.scene is not None
        rig, io = app.scene.rig, imgui.get_io()
        if imgui.is_item_hovered() and imgui.is_mouse_clicked(0):
            self._held = True
            rig.remember()
        self._held = self._held and imgui.is_mouse_down(0)
        if self._held and (io.mouse_delta.x or io.mouse_delta.y):
            rig.orbit(io.mouse_delta.x / height, io.mouse_delta.y / height)
            app.touch()
        if imgui.is_item_hovered() and io.mouse_wheel:
            rig.dolly(io.mouse_wheel)
            app.touch()


def _told(app: App) -> str:
    """What the picture shows, in a line."""
    preview, scene = app.exporting.preview, app.scene
    assert preview is not None and scene is not None
    if preview.working:
        return "Making a preview…"
    if preview.error:
        return f"{preview.error[:1].upper()}{preview.error[1:]}."
    if preview.geometry is None:
        return ""
    geometry, f = preview.geometry, preview.geometry.coarser
    of_points = "Gaussians" if app.exporting.plan.kind == "gaussians" else "points"
    what = f"{len(geometry.faces):,} triangles" if len(geometry.faces) else f"{len(geometry.vertices):,} {of_points}"
    return f"Preview: {what}." if f == 1 else f"Preview in voxels {f} times as large: {what}. The file is finer."
