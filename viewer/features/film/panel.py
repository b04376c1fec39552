"""Page of stills and films, and the camera path in the picture."""

from dataclasses import replace
from functools import partial

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as fa

from console.progress import duration
from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.files import FileRequest
from viewer.core.pose import FRUSTUM_EDGES, frustum_points
from viewer.core.screen import Screen
from viewer.core.widgets import Box, px
from viewer.features.bookmarks.panel import rearranging_buttons, row
from viewer.features.film.filming import LENS_QUALITY, PANORAMA_SIZES, SAMPLES, SIZES, STILL_MODES, Filming
from viewer.features.film.picture_export import FILMS, films_possible
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas

LIST_HEIGHT = 180.0
APERTURES, USUAL_APERTURE = (0.1, 20.0), 0.03  # of the scene's radius: percent, least and most; share


def show(app: App, canvas: Canvas) -> None:
    filming = app.filming
    with ui.card("path", "Camera path"):
        _path(app, canvas, filming)
    with ui.card("size", "Size"):
        _size(filming)
    with ui.card("still", "This view"):
        _still(app, filming)
    with ui.card("export", "Export"):
        _export(app, filming)
    with ui.card("scene", "Scene"):
        ui.hint("A mesh, points or Gaussians for other programs.")
        ui.command(app, "export-scene", f"{fa.ICON_FA_CUBE}  Export the scene…")


def _path(app: App, canvas: Canvas, filming: Filming) -> None:
    left, right = f"{fa.ICON_FA_PLUS}  Keyframe", f"{fa.ICON_FA_ROTATE}  Turntable"
    ui.two_commands(app, ("keyframe", left), ("turntable", right))
    path = filming.path
    if not path.keyframes:
        ui.hint("Move the camera and add keyframes (K). The film flies through them.")
    else:
        _keyframes(app, canvas, filming)
        path.closed = ui.switch("closed", path.closed, "Back to the start")
        icon = fa.ICON_FA_PAUSE if filming.playing else fa.ICON_FA_PLAY
        if ui.icon_button(icon, "play", "Play  (P)", on=filming.playing, enabled=len(path.keyframes) > 1):
            app.run("play")
        imgui.same_line()
        imgui.set_next_item_width(-1)
        changed, value = imgui.slider_float("##time", filming.time, 0.0, max(path.duration, 1e-3), "%.1f s")
        if changed:
            filming.playing = False
            filming.show(app, value)
    width = ui.half_width()
    if ui.button(f"{fa.ICON_FA_FOLDER_OPEN}  Load…", width):
        app.file_request = FileRequest("Load a camera path", "open", partial(filming.load, app), (".json",))
    imgui.same_line()
    if ui.button(f"{fa.ICON_FA_FLOPPY_DISK}  Save…", width, enabled=bool(path.keyframes)):
        save = partial(filming.save, app)
        app.file_request = FileRequest("Save the path", "save", save, (".json",), "camera_path.json")


def _keyframes(app: App, canvas: Canvas, filming: Filming) -> None:
    with ui.list_box("##keys", px(LIST_HEIGHT)):
        for i, key in enumerate(filming.path.keyframes):
            texts = f"Keyframe {i + 1}", f"{key.seconds:.1f} s"
            if row(app, canvas, f"key{i}", key, texts, chosen=i == filming.selected):
                filming.select(app, i)
    index = filming.selected
    if index is None or index >= len(filming.path.keyframes):
        return
    if how := rearranging_buttons():
        filming.rearrange(app, how, index)
        return
    imgui.set_next_item_width(-1)
    key = filming.path.keyframes[index]
    filming.path.keyframes[index] = replace(key, seconds=ui.slider("##leg", key.seconds, 0.2, 10.0, "%.1f s to next"))


def _size(filming: Filming) -> None:
    panorama = ui.switch("panorama", filming.panorama, "360°")
    ui.tip("All directions around the camera (equirectangular), level, twice as wide as high")
    sizes = PANORAMA_SIZES if panorama else SIZES
    if panorama != filming.panorama:
        filming.panorama, filming.size = panorama, next(iter(sizes))
    filming.size = ui.segments("##sizes", sizes, filming.size) or filming.size
    ui.label("Pixels")
    changed, value = imgui.input_int2("##pixels", list(filming.size))
    if changed:
        filming.set_size(*value[:2])
    filming.fps = float(round(ui.slider("Frames / s##fps", filming.fps, 10.0, 60.0, "%.0f")))
    filming.annotated = ui.switch("annotated", filming.annotated, "Annotated places")
    ui.tip("Draws their numbers and titles into saved views and films, unless they have no background")
    filming.samples = ui.segments("Anti-aliasing##samples", SAMPLES, filming.samples) or filming.samples


def _still(app: App, filming: Filming) -> None:
    """The tick list of what is saved, and where to."""
    filming.transparent = ui.switch("transparent", filming.transparent, "No background")
    ui.tip("Transparent, in the PNG or OpenEXR file")
    besides = []
    for mode, title in STILL_MODES.items():
        ui.label(title)
        if ui.switch(mode, mode in filming.besides):
            besides.append(mode)
        ui.tip(f"Save this as well: NAME_{mode}.png, or a channel of the OpenEXR file")
    filming.besides = tuple(besides)
    if not filming.panorama:
        _depth_of_field(app, filming)
    if ui.main_button(f"{fa.ICON_FA_CAMERA}  Save this view…", enabled=filming.export is None):
        filming.ask_for_still(app)
    ui.command(app, "copy-picture", f"{fa.ICON_FA_COPY}  Copy the picture", enabled=filming.export is None)
    ui.tip("The picture as it is shown, to the clipboard")


def _depth_of_field(app: App, filming: Filming) -> None:
    focusing = app.measure_tool.tool == "focus"
    if ui.switch("blur", filming.aperture > 0, "Depth of field") != (filming.aperture > 0):
        filming.aperture = 0.0 if filming.aperture else USUAL_APERTURE
        if focusing:
            app.measure_tool.choose(app, "")
    ui.tip("Blurs the saved view where it is out of focus, as a lens does")
    if not filming.aperture:
        return
    flags = imgui.SliderFlags_.logarithmic | imgui.SliderFlags_.always_clamp
    filming.aperture = ui.slider("Aperture", filming.aperture, *APERTURES, "%.2f %%", times=100.0, flags=flags)
    ui.tip("Diameter of the opening, of the scene's radius")
    filming.lens_rays = ui.segments("Quality##rays", LENS_QUALITY, filming.lens_rays) or filming.lens_rays
    width = ui.half_width()
    if ui.button(f"{'Click on a surface' if focusing else 'Choose the focus'}###focus", width):
        app.measure_tool.choose(app, "" if focusing else "focus")
    imgui.same_line()
    if ui.button("The middle", width):
        filming.focus = None
        if focusing:
            app.measure_tool.choose(app, "")
    ui.hint("In focus: the middle of the picture." if filming.focus is None else "In focus: the chosen place.")


def _export(app: App, filming: Filming) -> None:
    export = filming.export
    if export is not None:
        percent, left = 100 * export.share, export.seconds_left
        imgui.text_unformatted(ui.elided(export.target.name, imgui.get_content_region_avail().x))
        imgui.progress_bar(export.share, ImVec2(-1, px(8)), "")
        ui.hint(f"{percent:.0f} %" if left is None else f"{percent:.0f} %, about {duration(left)} left")
        if ui.button("Cancel"):
            filming.cancel(app)
        return
    width, write, possible = ui.half_width(), partial(filming.film, app), bool(filming.path.keyframes)
    if ui.button(f"{fa.ICON_FA_FILM}  Film…", width, enabled=possible and films_possible()):
        app.file_request = FileRequest("Save the film", "save", write, tuple(FILMS), "flight.mp4")
    imgui.same_line()
    if ui.button(f"{fa.ICON_FA_IMAGES}  Pictures…", width, enabled=possible):
        app.file_request = FileRequest("A new folder for the pictures", "save", write, (), "flight")
    if not films_possible():
        ui.hint("Films need PyAV: pip install 'snerg[video]'")


PATH_STEPS = 24  # line segments per leg


def draw_path(app: App, box: Box) -> None:
    """The camera path and its keyframes, while its page is open and it is not being played."""
    filming = app.filming
    if not app.interface.shows("film") or filming.playing or not filming.path.keyframes:
        return
    screen, path = Screen(app, box), filming.path
    if len(path.keyframes) > 1:
        count = PATH_STEPS * len(path.keyframes)
        matrices, _ = path.poses(path.duration * np.arange(count + 1) / count)
        screen.lines(matrices[:, :3, 3], [(i, i + 1) for i in range(count)], theme.packed(theme.ACCENT), px(2))
    rig = app.open_scene.rig
    depth = 0.05 if rig.bounded else 0.12 * rig.radius
    for i, key in enumerate(path.keyframes):
        colour = theme.packed(theme.WARN if i == filming.selected else theme.ACCENT)
        camera = ViewCamera.posed(key.grid_T_camera, key.fov, filming.size)
        screen.lines(frustum_points(camera, depth), FRUSTUM_EDGES, colour, px(1.5))
