"""Picture page: mode, background, resolution; and the legend of false colours."""

from dataclasses import dataclass, replace
from itertools import pairwise

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.core import theme
from viewer.core import widgets as ui
from viewer.core.widgets import Box, px
from viewer.features.display.display import BACKGROUNDS, PLAIN, modes_for, set_look
from viewer.features.performance.panel import frame_times
from viewer.rendering.canvas import Canvas
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.renderer import COLOUR_STOPS
from viewer.rendering.settings import LOOKS, Look

MODE_WORDS = {  # the title of each mode, and what it shows
    "normal": ("Picture", "What a camera sees."),
    "diffuse": ("Diffuse colour", "Without the view-dependent part."),
    "features": ("Features", "The first three features, inputs of the view MLP."),
    "view-dependent": ("View-dependent colour", "Only what the view MLP adds."),
    "alpha": ("Opacity", "White is opaque."),
    "depth": ("Depth", "Near is bright."),
    "normals": ("Normals", "Which way surfaces face: x, y, z as red, green, blue."),
    "samples": ("Cost: samples", "How many voxels each ray fetched."),
    "jumps": ("Cost: jumps", "How many jumps over empty space each ray made."),
    "macroblocks": ("Macroblocks", "One colour for each macroblock that a ray hits first."),
    "atlas": ("Atlas", "All macroblocks as they lie in memory."),
}
RESOLUTIONS = {1.0: "Full", 0.75: "75 %", 0.5: "Half", 0.25: "Quarter"}
BACKDROPS = {PLAIN: "Plain", "gradient": "Gradient", "checker": "Checker"}


def show(app: App, canvas: Canvas) -> None:
    with ui.card("mode", "Display"):
        titles = {mode: MODE_WORDS[mode][0] for mode in modes_for(app)}
        app.set(mode=ui.choice("Mode", titles, MODE_WORDS[app.settings.mode][0]) or app.settings.mode)
        ui.hint(MODE_WORDS[app.settings.mode][1])
        if app.settings.mode in ("samples", "jumps"):
            app.set(cost_scale=ui.slider("Maximum##cost", app.settings.cost_scale, 4.0, 512.0, "%.0f"))
        _background(app)
        if app.open_scene.pack.contraction is not None:
            app.set(surroundings=ui.switch("surroundings", app.settings.surroundings, "Surroundings"))
            ui.tip("What lies beyond the inner cube of an unbounded scene")
    with ui.card("look", "Colour"):
        _look(app)
    with ui.card("resolution", "Resolution"):
        if picked := ui.segments("##rest", RESOLUTIONS, app.resolution.rest_scale):
            app.resolution.rest_scale = picked
            app.touch()
        app.resolution.enabled = ui.switch("dynamic", app.resolution.enabled, "Dynamic resolution")
        if app.resolution.enabled:
            app.resolution.target_fps = ui.slider("Target", app.resolution.target_fps, 10.0, 120.0, "%.0f fps")
        ui.hint("Draws fewer pixels while the camera moves, and all of them when it rests.")
    with ui.card("time", "Frame time"):
        frame_times(app, px(84))
        width, height = canvas.drawn_size
        ui.figure("Pixels drawn", f"{width} × {height}")


def _look(app: App) -> None:
    look = app.annotations.current.look or Look()
    for name, (least, most) in LOOKS.items():
        title = f"{name.capitalize()}##{name}"
        if (value := ui.undoable_slider(app, title, getattr(look, name), least, most, "%.2f")) is not None:
            set_look(app, **{name: value})
    if ui.button("Colours as they are", enabled=look != Look()):
        app.annotations.change(app, replace(app.annotations.current, look=None))
    of_scene = "Of the scene, not of its background; kept with the pack."
    ui.hint(f"{of_scene} Comparisons with photographs show colours as they are.")


def _background(app: App) -> None:
    ui.label("Background")
    current = app.settings.background
    side, gap = px(26), px(8)
    draw = imgui.get_window_draw_list()
    for name, colour in BACKGROUNDS.items():
        at = imgui.get_cursor_screen_pos()
        if imgui.invisible_button(f"##bg {name}", ImVec2(side, side)):
            app.set(background=colour, backdrop=None)
        ui.tip(name)
        middle = ImVec2(at.x + side / 2, at.y + side / 2)
        shade = imgui.color_convert_float4_to_u32((*colour, 1.0))
        draw.add_circle_filled(middle, side / 2 - px(3), shade)
        chosen = current == colour and app.settings.backdrop is None
        ring, radius, width = (theme.ACCENT, px(1), px(2)) if chosen else (theme.FAINT, px(3), px(1))
        draw.add_circle(middle, side / 2 - radius, theme.packed(ring), 0, width)
        imgui.same_line(0, gap)
    flags = imgui.ColorEditFlags_.no_inputs | imgui.ColorEditFlags_.no_alpha
    changed, value = imgui.color_edit3("##other", list(current), flags)
    ui.tip("Another colour")
    if changed:
        app.set(background=tuple(float(v) for v in value[:3]), backdrop=None)
    now = app.settings.backdrop.style if app.settings.backdrop is not None else PLAIN
    if picked := ui.segments("Behind it", BACKDROPS, now):
        app.set_backdrop(picked)
    ui.tip("By opacity, after shading: the colours of the scene stay those that it was trained with")


# --- What the colours of a false-colour picture mean: a bar with numbers and their unit, in the picture's ---
BAR = (200.0, 12.0)  # width, height
LEGEND_PADDING = 12.0
GREY = ((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
COUNTED = {"samples": "voxels fetched per ray", "jumps": "jumps per ray"}


@dataclass(frozen=True)
class Legend:
    """stops: colours, evenly spaced from left to right. low, middle, high: numbers below the bar. unit: what they count."""

    stops: tuple[tuple[float, float, float], ...]
    low: str
    middle: str
    high: str
    unit: str


def legend_of(app: App) -> Legend | None:
    """The legend of the mode that is shown; None where it needs none."""
    camera, mode = app.viewport.camera, app.settings.mode
    if camera is None or app.scene is None:
        return None
    if mode in COUNTED:
        scale = app.settings.cost_scale
        return Legend(COLOUR_STOPS, "0", f"{scale / 2:.0f}", f"≥ {scale:.0f}", COUNTED[mode])
    if mode == "depth":
        pack = app.scene.pack
        near, far = RayFrame(pack).depth_range(camera)
        if pack.ndc:
            return Legend(GREY, f"{near:.0f}", f"{(near + far) / 2:.0f}", f"{far:.0f}", "voxels into the warped grid")
        near, far = near * pack.voxel_size, far * pack.voxel_size
        high = f"≥ {far:.3g}" if pack.contraction is not None else f"{far:.3g}"
        return Legend(GREY, f"{near:.3g}", f"{(near + far) / 2:.3g}", high, "distance, in the grid's units")
    return None


def show_legend(app: App, box: Box) -> None:
    """Draws it over the picture's box, where it has room."""
    legend = legend_of(app)
    if legend is None:
        return
    draw = imgui.get_window_draw_list()
    with ui.font(None, theme.SMALL):
        line = imgui.get_text_line_height()
        width = min(px(BAR[0]), box[2] - px(28 + 2 * LEGEND_PADDING))
        height = px(BAR[1]) + 2 * line + px(10)
        pad = px(LEGEND_PADDING)
        left, top = box[0] + px(14) + pad, box[1] + box[3] - px(14) - pad - height
        if width < px(90) or top - pad < box[1]:
            return
        low, high = ImVec2(left - pad, top - pad), ImVec2(left + width + pad, top + height + pad)
        draw.add_rect_filled(low, high, theme.packed(theme.BASE, 0.82), px(10))
        draw.add_text(ImVec2(left, top), theme.packed(theme.MUTED), legend.unit)
        y = top + line + px(4)
        step, foot = width / (len(legend.stops) - 1), y + px(BAR[1])
        packed = [imgui.color_convert_float4_to_u32((*stop, 1.0)) for stop in legend.stops]
        for i, (a, b) in enumerate(pairwise(packed)):
            x = left + i * step
            draw.add_rect_filled_multi_color(ImVec2(x, y), ImVec2(x + step, foot), a, b, b, a)
        draw.add_rect(ImVec2(left, y), ImVec2(left + width, foot), theme.packed(theme.LINE))
        y = foot + px(4)
        for text, place in ((legend.low, 0.0), (legend.middle, 0.5), (legend.high, 1.0)):
            wide = imgui.calc_text_size(text).x
            draw.add_text(ImVec2(left + place * (width - wide), y), theme.packed(theme.TEXT), text)
