"""How the picture is drawn: display mode, background, resolution, and how long it takes."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui

from viewer.app.application import App
from viewer.app.commands import modes_for
from viewer.app.preferences import PLAIN
from viewer.app.state import BACKGROUNDS
from viewer.panels import page_performance, theme
from viewer.panels.theme import Fonts
from viewer.panels.widgets import card, choice, figure, hint, label, px, segments, switch, tip
from viewer.rendering.canvas import Canvas

MODE_TITLES = {
    "normal": "Picture",
    "diffuse": "Diffuse colour",
    "features": "Features",
    "view-dependent": "View-dependent colour",
    "alpha": "Opacity",
    "depth": "Depth",
    "normals": "Normals",
    "samples": "Cost: samples",
    "jumps": "Cost: jumps",
    "macroblocks": "Macroblocks",
    "atlas": "Atlas",
}
MODE_HINTS = {
    "normal": "What a camera sees.",
    "diffuse": "Without the view-dependent part.",
    "features": "The first three features, inputs of the view MLP.",
    "view-dependent": "Only what the view MLP adds.",
    "alpha": "White is opaque.",
    "depth": "Near is bright.",
    "normals": "Which way surfaces face: x, y, z as red, green, blue.",
    "samples": "How many voxels each ray fetched.",
    "jumps": "How many jumps over empty space each ray made.",
    "macroblocks": "One colour for each macroblock that a ray hits first.",
    "atlas": "All macroblocks as they lie in memory.",
}
RESOLUTIONS = {"1.0": "Full", "0.75": "75 %", "0.5": "Half", "0.25": "Quarter"}


def show(app: App, canvas: Canvas, fonts: Fonts) -> None:
    """Draws the page."""
    with card("mode", fonts, "Display"):
        label("Mode")
        picked = choice("mode", modes_for(app), app.settings.mode, MODE_TITLES)
        if picked:
            app.set(mode=picked)
        hint(MODE_HINTS.get(app.settings.mode, ""))
        if app.settings.mode in ("samples", "jumps"):
            label("Maximum")
            changed, value = imgui.slider_float("##cost", app.settings.cost_scale, 4.0, 512.0, "%.0f")
            if changed:
                app.set(cost_scale=value)
        _background(app)
        if app.scene is not None and app.scene.pack.contraction is not None:
            label("Surroundings")
            shown = switch("surroundings", app.settings.surroundings)
            if shown != app.settings.surroundings:
                app.set(surroundings=shown)
            tip("What lies beyond the inner cube of an unbounded scene")
    with card("resolution", fonts, "Resolution"):
        picked = segments("rest", list(RESOLUTIONS), str(app.resolution.rest_scale), RESOLUTIONS)
        if picked:
            app.resolution.rest_scale = float(picked)
            app.touch()
        label("Dynamic resolution")
        app.resolution.enabled = switch("dynamic", app.resolution.enabled)
        if app.resolution.enabled:
            label("Target")
            changed, fps = imgui.slider_float("##target", app.resolution.target_fps, 10.0, 120.0, "%.0f fps")
            if changed:
                app.resolution.target_fps = fps
        hint("Draws fewer pixels while the camera moves, and all of them when it rests.")
    with card("time", fonts, "Frame time"):
        page_performance.headline(app, fonts)
        page_performance.rolling(app.times, app.resolution.target_ms, px(84))
        width, height = canvas.drawn_size
        figure("Pixels drawn", f"{width} × {height}", fonts)


def _background(app: App) -> None:
    label("Background")
    current = app.settings.background
    side, gap = px(26), px(8)
    draw = imgui.get_window_draw_list()
    for name, colour in BACKGROUNDS.items():
        at = imgui.get_cursor_screen_pos()
        if imgui.invisible_button(f"##bg {name}", ImVec2(side, side)):
            app.set(background=colour, backdrop=None)
        if imgui.is_item_hovered():
            imgui.set_tooltip(name)
        middle = ImVec2(at.x + side / 2, at.y + side / 2)
        code = "#" + "".join(f"{round(255 * v):02x}" for v in colour)
        draw.add_circle_filled(middle, side / 2 - px(3), theme.packed(code))
        chosen = current == colour and app.settings.backdrop is None
        ring, radius, width = (theme.ACCENT, px(1), px(2)) if chosen else (theme.FAINT, px(3), px(1))
        draw.add_circle(middle, side / 2 - radius, theme.packed(ring), 0, width)
        imgui.same_line(0, gap)
    flags = imgui.ColorEditFlags_.no_inputs | imgui.ColorEditFlags_.no_alpha
    changed, value = imgui.color_edit3("##other", list(current), flags)
    if imgui.is_item_hovered():
        imgui.set_tooltip("Another colour")
    if changed:
        app.set(background=tuple(float(v) for v in value[:3]), backdrop=None)
    label("Behind it")
    titles = {PLAIN: "Plain", "gradient": "Gradient", "checker": "Checker"}
    now = app.settings.backdrop.style if app.settings.backdrop is not None else PLAIN
    picked = segments("backdrop", list(titles), now, titles)
    if picked:
        app.set_backdrop(picked)
    tip("By opacity, after shading: the colours of the scene stay those that it was trained with")
