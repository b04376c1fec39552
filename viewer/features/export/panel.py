"""Export dialog, with its preview, and the cards of an export and of what is shared."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui, imgui_ctx
from imgui_bundle import icons_fontawesome_6 as fa

from scenepack.exports.field import Frame
from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.widgets import BUTTON_WIDTH, Box, px
from viewer.features.export.exporting import FACES, KEPT, LEVELS, SPACINGS, ExportPlan, ExportPreview, Kind
from viewer.features.making.panel import with_time_left
from viewer.rendering.canvas import Canvas

NAME, WIDTH, PADDING, LABELS = "##export", 480.0, 26.0, 130.0
CHOICES, GAP, WIDEST_PREVIEW, NARROWEST_PREVIEW = 428.0, 22.0, 460.0, 220.0
ROWS_HIGH = 262.0  # of the preview: as high as the most choices
KINDS: dict[Kind, tuple[str, str]] = {
    "mesh": ("Mesh", "Triangles with vertex colours: a .glb or .ply file."),
    "points": ("Points", "Points on the surface with normals and colours: a .ply file."),
    "gaussians": ("Gaussians", "A Gaussian for each voxel: a .ply or .spz file for splat viewers, without highlights."),
    "page": ("Web page", "One .html file that shows the scene in any browser."),
}


def show(app: App, canvas: Canvas, pane: PreviewPane) -> None:
    """Draws the question while there is one, and nothing is in front of it. pane: the same one each time."""
    exporting = app.exporting
    if exporting.preview is None:
        pane.drop(canvas)
    if app.scene is None or ui.in_front(app) != "export":
        return
    room = imgui.get_io().display_size.x / px(1) - 32 - CHOICES - GAP - 2 * PADDING  # a small window has no preview
    beside = min(room, WIDEST_PREVIEW) if room >= NARROWEST_PREVIEW else 0.0
    width = CHOICES + GAP + beside + 2 * PADDING if beside else WIDTH
    if not ui.begin_modal(NAME, width, 0.47, padding=(PADDING, 22)):
        return
    ui.heading(fa.ICON_FA_CUBE, f"Export {app.scene.name}")
    imgui.dummy(ImVec2(0, px(4)))
    if beside:
        flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.nav_flattened
        with imgui_ctx.begin_child("##choices", ImVec2(px(CHOICES), 0), flags):
            _choices(app, exporting.plan)
        imgui.same_line(0, px(GAP))
        with imgui_ctx.begin_group():
            if exporting.plan.kind == "page":
                imgui.dummy(ImVec2(px(beside), px(ROWS_HIGH)))  # it looks like the scene
            else:
                pane.show(app, canvas, px(beside), px(ROWS_HIGH))
    else:
        _choices(app, exporting.plan)
    imgui.dummy(ImVec2(0, px(8)))
    cancelled, wanted = ui.cancel_or("Export…", 112, PADDING)
    wanted = wanted or ui.pressed_here(imgui.Key.enter)
    if cancelled or wanted:
        imgui.close_current_popup()
    if cancelled:
        exporting.dismiss()
    elif wanted:
        exporting.choose_file(app)
    imgui.end_popup()


def _choices(app: App, plan: ExportPlan) -> None:
    plan.kind = ui.explained("As##kind", KINDS, plan.kind, LABELS)
    if plan.kind in ("mesh", "points"):
        ui.label("Opacity level", LABELS)
        plan.level = ui.slider("##level", plan.level, *LEVELS, "%.2f")
        ui.tip("Where the surface lies. Lower includes thinner mist.")
        plan.keep = ui.segments("Parts##keep", KEPT, plan.keep, LABELS) or plan.keep
        plan.smooth = ui.switch("smooth", plan.smooth, "Smooth")
    if plan.kind == "mesh":
        faces = ui.segments("Triangles##faces", FACES, plan.faces, LABELS)
        plan.faces = plan.faces if faces is None else faces
    elif plan.kind == "points":
        plan.spacing = ui.segments("Density##spacing", SPACINGS, plan.spacing, LABELS) or plan.spacing
    if plan.kind != "page":
        units = app.annotations.current.scale.unit or "its units"
        frames: dict[Frame, tuple[str, str]] = {
            "placed": ("As placed", f"As on the Move page, y up. Lengths are in {units}."),
            "grid": ("Grid", "The grid's, y up, in its own units."),
            "world": ("Training", "That of the photographs' poses, in its own units."),
        }
        plan.frame = ui.explained("Frame", frames, plan.frame, LABELS)
    if app.settings.crop is not None:
        plan.crop = ui.switch("cropped", plan.crop, "Crop box only")
    if plan.kind == "page":
        imgui.dummy(ImVec2(0, px(4)))
        if ui.button(f"{fa.ICON_FA_SHARE_NODES}  Share…", px(112)):
            imgui.close_current_popup()
            app.exporting.dismiss()
            app.run("share")
        imgui.same_line()
        ui.hint("Serves the page to browsers on this computer, without a file.")


def show_card(app: App, box: Box) -> None:
    """How far it is, at the lower left of the viewport's box; not while a scene is being made, whose card is there."""
    writing = app.exporting.writing
    if writing is None or app.making.job is not None:
        return
    with ui.corner_card("##exporting", box):
        if ui.titled_button(writing.file.name, "Cancel##export"):
            app.exporting.cancel()
        report, stopping = writing.child.report, writing.child.stopping
        imgui.progress_bar(report.share if report else 0.0, ImVec2(-1, px(6)), "")
        if stopping or report is None:
            ui.hint("Stopping…" if stopping else "Starting…")
        else:
            words = report.note or report.title
            ui.hint(with_time_left(f"{words[:1].upper()}{words[1:]}, {100 * report.share:.0f} %", report))


def show_sharing(app: App, box: Box) -> None:
    """The card with the address under which the open pack is shared, where no other card is."""
    server = app.sharing.server
    if server is None or app.making.job is not None or app.exporting.writing is not None:
        return
    with ui.corner_card("##sharing", box):
        if ui.titled_button(f"Sharing {server.name}", "Stop##sharing"):
            app.sharing.end()
        if not server.address:
            ui.hint("Making the page…")
            return
        width = px(BUTTON_WIDTH)
        imgui.set_next_item_width(-width - px(8))
        imgui.input_text("##address", server.address, imgui.InputTextFlags_.read_only)
        imgui.same_line()
        if ui.button(f"{fa.ICON_FA_COPY}  Copy##address", width):
            app.copy(server.address, "The address is on the clipboard")
        ui.tip("Open it in a browser on this computer")
        ui.hint("Only this computer can open it, until you stop it or close the viewer.")


# --- The picture of what an export would write ---

IMAGE = "export preview"
FINER = 2  # pixels drawn along each side of one that is shown: edges become smooth


class PreviewPane:
    """Keeps the picture while neither camera nor geometry changes."""

    def __init__(self) -> None:
        self._of: tuple[object, ...] = ()
        self._pixels = None
        self._held = False  # by the mouse

    def show(self, app: App, canvas: Canvas, width: float, height: float) -> None:
        """width, height: of the picture, in window units; a line of text comes below it."""
        preview, scene = app.exporting.preview, app.open_scene
        if preview is None:
            return
        at = imgui.get_cursor_screen_pos()
        imgui.dummy(ImVec2(width, height))  # no button, which Tab would come to
        self._turn(app, height)
        draw, corner = imgui.get_window_draw_list(), ImVec2(at.x + width, at.y + height)
        draw.add_rect_filled(at, corner, theme.packed(theme.BASE), px(6))
        if preview.geometry is not None:
            density = FINER * imgui.get_io().display_framebuffer_scale.x
            camera = scene.rig.camera((round(density * width), round(density * height)))
            if self._pixels is None or (preview.geometry, camera.key) != self._of:
                ground = theme.rgb(theme.BASE)
                self._pixels = canvas.draw_export_preview(preview.geometry, camera, (ground.x, ground.y, ground.z))
                self._of = preview.geometry, camera.key
            opacity = 0.35 if preview.error else 1.0
            ui.draw_picture(canvas.image(IMAGE, self._pixels), at, corner, opacity=opacity, rounding=6)
        if preview.working:
            low = ImVec2(at.x + width * preview.share, corner.y)
            draw.add_rect_filled(ImVec2(at.x, corner.y - px(3)), low, theme.packed(theme.ACCENT))
        text = _preview_text(preview, "Gaussians" if app.exporting.plan.kind == "gaussians" else "points")
        ui.hint(text, theme.WARN if preview.error and not preview.working else theme.FAINT)

    def drop(self, canvas: Canvas) -> None:
        """Frees what it holds on the card."""
        if self._pixels is not None:
            canvas.drop_image(IMAGE)
            canvas.drop_export_preview()
        self._of, self._pixels = (), None

    def _turn(self, app: App, height: float) -> None:
        """What the mouse does on the picture: it orbits, and the wheel moves closer."""
        rig, io = app.open_scene.rig, imgui.get_io()
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


def _preview_text(preview: ExportPreview, of_points: str) -> str:
    if preview.working:
        return "Making a preview…"
    if preview.error:
        return f"{preview.error[:1].upper()}{preview.error[1:]}."
    if preview.geometry is None:
        return ""
    geometry, f = preview.geometry, preview.geometry.coarser
    what = f"{len(geometry.faces):,} triangles" if len(geometry.faces) else f"{len(geometry.vertices):,} {of_points}"
    return f"Preview: {what}." if f == 1 else f"Preview in voxels {f} times as large: {what}. The file is finer."
