"""Draws a pack into a framebuffer that the caller hands in: window, screenshot, benchmark and test run this code.

Every GL state that drawing relies on is set in each call, since imgui shares the context.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import ceil, inf
from typing import Any

import moderngl

from console import Notice, UserError, notify
from scenepack.contraction import contract
from scenepack.pack import Pack
from viewer.rendering.camera import ViewCamera
from viewer.rendering.gpu_scene import GpuScene, NoRoomError, features_stored, half_resolution, upload
from viewer.rendering.opengl import Drawing, begin_drawing
from viewer.rendering.ray_frame import RayFrame
from viewer.rendering.settings import MARCHERS, MODES, Look, RenderSettings
from viewer.rendering.shader_source import assemble, glsl_vec3, view_mlp_includes
from viewer.rendering.skip_grid import CELL, skip_grid_of
from viewer.rendering.supersampling import Supersampling

GL_FRAMEBUFFER_SRGB = 0x8DB9
GL_DEPTH_CLAMP = 0x864F
SHADED_MODES = ("normal", "view-dependent")
LEAST_HALVED = 64  # voxels along the grid's longest side; smaller packs are not halved
MODES_WITH_LOOK = ("normal", "diffuse")
COST_MODES = ("samples", "jumps")  # as the components of a raw picture of either come
MODES_WITH_BLUR = ("normal", "diffuse", "features", "view-dependent", "alpha")  # not those of numbers and costs
# False colours of counts, RGB in 0 … 1, evenly spaced: black, blue, magenta, orange, white, like matplotlib's "inferno".
COLOUR_STOPS = ((0.0, 0.0, 0.0), (0.25, 0.05, 0.45), (0.75, 0.2, 0.35), (0.98, 0.6, 0.1), (1.0, 1.0, 0.85))
MODES_OVER_BACKGROUND = ("normal", "diffuse", "macroblocks", "atlas")  # the others are black where there is nothing


def _layout(marcher: str) -> str:
    return "paper" if marcher == "paper" else "exact"


def _halved_message(whole: Pack, half: Pack, error: NoRoomError) -> str:
    def size(pack: Pack) -> str:
        voxels = int(pack.occupied.sum()) * pack.padded_block_size**3
        channels = 8 if features_stored(pack) else 4
        return f"{'x'.join(map(str, pack.grid_size))} voxels, {voxels * channels / 2**20:.0f} MiB"

    share = {2: "half", 4: "a quarter of its"}.get(round(half.voxel_size / whole.voxel_size), "a fraction of its")
    return f"shown at {share} resolution, {size(half)}, for the whole, {size(whole)}, does not fit: {error}"


class Renderer:
    """A pack on the GPU and the programs that draw it. Textures of a marcher are uploaded when it is first asked for.

    ctx: an OpenGL 3.3 context, current. marcher: uploaded first. at_once: fill its textures now; otherwise arrive() does, bit by
    bit, and what has arrived is drawn. A pack that does not fit is shown at half resolution, or half of that, with a Notice;
    `pack` is what is shown. NoRoomError where not even a pack of less than LEAST_HALVED voxels a side would fit, and at once
    without allow_half: figures of a pack must not be those of another.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        pack: Pack,
        marcher: str = "exact",
        *,
        at_once: bool = True,
        allow_half: bool = True,
    ) -> None:
        self.ctx = ctx
        self._scenes: dict[str, GpuScene] = {}
        self._supersampling = Supersampling(ctx)
        self._drawings: dict[tuple[Any, ...] | str, Drawing] = {}
        self.pack = pack
        refused: NoRoomError | None = None
        while not self._scenes:
            try:
                self._scenes[_layout(marcher)] = upload(ctx, self.pack, _layout(marcher), at_once=at_once)
            except NoRoomError as error:
                refused = refused or error
                if not allow_half or max(self.pack.grid_size) < LEAST_HALVED:
                    raise refused from error
                self.pack = half_resolution(self.pack)
        if refused is not None:
            notify(Notice(_halved_message(pack, self.pack, refused)))
        self._ray_frame = RayFrame(self.pack)

    def scene(self, marcher: str) -> GpuScene:
        layout = _layout(marcher)
        if layout not in self._scenes:
            self._scenes[layout] = upload(self.ctx, self.pack, layout)
        return self._scenes[layout]

    def see_first(self, camera: ViewCamera) -> None:
        """What lies close to `camera` shall arrive first. Cameras of forward-facing packs lie all on one side of them."""
        if not self.pack.ndc:
            radius, place = self.pack.contraction, camera.position
            if radius is not None:
                place = radius * contract(place / radius)
            for scene in self._scenes.values():
                scene.near = (place - self.pack.min_xyz) / self.pack.voxel_size

    def arrive(self, seconds: float = inf) -> bool:
        """Goes on filling the textures for about `seconds`; True where the whole pack is there."""
        return all([scene.arrive(seconds) for scene in self._scenes.values()])

    @property
    def arriving(self) -> bool:
        """Whether a part of the pack is not on the GPU yet."""
        return any(scene.arriving is not None for scene in self._scenes.values())

    def rewrite(self, numbers: Sequence[int]) -> None:
        """Uploads macroblocks, by their number in the grid's order, again: the atlas of `pack` has changed there.

        Voxels that were empty when the pack was first shown must still be.
        """
        for scene in self._scenes.values():
            scene.rewrite(numbers)

    def gpu_bytes(self, marcher: str | None = None) -> int:
        """Bytes of texture memory that `marcher` uses; None: that all marchers use that were asked for."""
        return self.scene(marcher).gpu_bytes if marcher else sum(scene.gpu_bytes for scene in self._scenes.values())

    def render(
        self,
        framebuffer: moderngl.Framebuffer,
        camera: ViewCamera,
        settings: RenderSettings | None = None,
        corner: tuple[int, int] = (0, 0),
    ) -> None:
        """Draws the view of `camera` into `framebuffer`, over whatever was there. corner: the lower left one's pixel."""
        settings = settings or RenderSettings()
        if camera.orthographic and self.pack.ndc:
            raise UserError("a forward-facing pack has no orthographic view", remedy="choose a perspective one")
        aperture = settings.aperture if settings.mode in MODES_WITH_BLUR else None
        if settings.samples > 1 or aperture is not None:
            self._supersampling.draw(self.render, framebuffer, camera, replace(settings, aperture=aperture), corner)
            return
        scene = self.scene(settings.marcher)
        rays = self._rays(settings, camera)
        uniforms = self._uniforms(scene, camera, settings, corner)
        rays.write(uniforms)
        ctx, box = self.ctx, (*corner, camera.width, camera.height)
        begin_drawing(framebuffer, box)
        ctx.disable_direct(GL_FRAMEBUFFER_SRGB)
        ctx.wireframe = False
        scene.bind(rays.linked)
        if shades_hull_alone(self.pack, settings) and not any(camera.distortion):
            colour = settings.background if settings.mode in MODES_OVER_BACKGROUND else (0.0, 0.0, 0.0)
            framebuffer.depth_mask = True
            framebuffer.clear(*((0.0,) * 4 if settings.raw else (*colour, 1.0)), depth=1.0, viewport=box)
            if _style(settings):
                self._draw_backdrop(framebuffer, settings, uniforms)
            if len(skip_grid_of(self.pack).hull):
                self._mark_hull(framebuffer, camera, uniforms)
            ctx.enable_only(moderngl.DEPTH_TEST)
            ctx.depth_func = ">"
        rays.draw(3)
        ctx.enable_only(moderngl.NOTHING)
        ctx.depth_func = "<"
        ctx.clear_samplers(0, len(scene.textures))  # imgui uses the units, too

    def _draw_backdrop(
        self, framebuffer: moderngl.Framebuffer, settings: RenderSettings, uniforms: dict[str, Any]
    ) -> None:
        """Fills the picture with its backdrop, to be seen in the pixels whose rays are not cast."""
        style = _style(settings)
        if style not in self._drawings:
            text = assemble("backdrop.frag", {"BACKDROP_CHECKER": style == "checker"})
            self._drawings[style] = Drawing(self.ctx, assemble("fullscreen.vert"), text)
        backdrop = self._drawings[style]
        backdrop.write(uniforms)
        framebuffer.depth_mask = False
        backdrop.draw(3)
        framebuffer.depth_mask = True

    def _mark_hull(self, framebuffer: moderngl.Framebuffer, camera: ViewCamera, uniforms: dict[str, Any]) -> None:
        """Leaves depth 0.5 in the pixels that see the hull of all content; see shaders/content_hull.vert."""
        ctx = self.ctx
        if "hull" not in self._drawings:
            shaders = assemble("content_hull.vert"), assemble("content_hull.frag")
            self._drawings["hull"] = Drawing(ctx, *shaders, skip_grid_of(self.pack).hull, "3f", "corner")
        triangles = self._drawings["hull"]
        triangles.write(uniforms)
        framebuffer.color_mask = (False, False, False, False)
        ctx.enable_direct(GL_DEPTH_CLAMP)
        ctx.enable_only(moderngl.CULL_FACE | moderngl.DEPTH_TEST)
        ctx.cull_face, ctx.depth_func = "front", "1"
        ctx.front_face = "cw" if camera.mirrored else "ccw"
        triangles.draw()
        ctx.disable_direct(GL_DEPTH_CLAMP)
        ctx.cull_face, ctx.front_face = "back", "ccw"
        framebuffer.color_mask = (True, True, True, True)
        framebuffer.depth_mask = False

    def release(self) -> None:
        """Frees textures and programs; the renderer cannot be used afterwards."""
        for scene in self._scenes.values():
            scene.release()
        for drawing in self._drawings.values():
            drawing.release()
        self._supersampling.release()
        self._scenes, self._drawings = {}, {}

    def _rays(self, settings: RenderSettings, camera: ViewCamera) -> Drawing:
        ablated, lens = settings.view_mlp_per_sample, any(camera.distortion)
        key = (settings.marcher, settings.mode, settings.raw, ablated, lens, camera.orthographic)
        key += (_style(settings), settings.look is None)
        if key not in self._drawings:
            scene = self.scene(settings.marcher)
            defines = shader_defines(
                self.pack,
                settings,
                sizes=scene.sizes,
                features_beside=scene.features_beside,
                distortion=lens,
                orthographic=camera.orthographic,
            )
            text = assemble("snerg.frag", defines, view_mlp_includes(self.pack.view_mlp))
            self._drawings[key] = Drawing(self.ctx, assemble("fullscreen.vert"), text)
        return self._drawings[key]

    def _uniforms(
        self, scene: GpuScene, camera: ViewCamera, settings: RenderSettings, corner: tuple[int, int]
    ) -> dict[str, Any]:
        values = self._ray_frame.uniforms(camera, settings) | {
            "viewport_origin": corner,
            "atlas_slots": scene.slots,
            "atlas_count": len(scene.blocks),
            "atlas_side": ceil(round(max(len(scene.blocks), 1) ** (1 / 3), 9)),  # of the smallest cube that holds all
            "grid_size": self.pack.grid_size,
            "content_min": lambda: skip_grid_of(self.pack).content_min,
            "content_max": lambda: skip_grid_of(self.pack).content_max,
            "background": settings.background,
            "cost_scale": settings.cost_scale,
            "backdrop_height": camera.whole_height or camera.height,
            **look_uniforms(settings.look),
        }
        if (behind := settings.backdrop) is not None:
            values |= {"backdrop_first": behind.first, "backdrop_second": behind.second}
        return values


def shader_defines(
    pack: Pack,
    settings: RenderSettings,
    *,
    sizes: Mapping[str, tuple[int, int, int]],
    features_beside: bool,
    distortion: bool = False,
    orthographic: bool = False,
) -> dict[str, object]:
    """Options of shaders/snerg.frag, which names them.

    sizes: texels (x, y, z) of the textures (GpuScene.sizes). features_beside: features lie beside rgba in one atlas.
    distortion, orthographic: what the camera has.
    """
    mode = settings.mode
    shaded = mode in SHADED_MODES and pack.view_mlp is not None
    defines: dict[str, object] = {f"MARCHER_{name.upper()}": i for i, name in enumerate(MARCHERS)}
    defines |= {f"MODE_{name.upper().replace('-', '_')}": i for i, name in enumerate(MODES)}
    stored = features_stored(pack)
    accumulates_features = stored and (shaded or mode == "features")
    return defines | {
        "MARCHER": MARCHERS.index(settings.marcher),
        "MODE": MODES.index(mode),
        "BLOCK_SIZE": pack.block_size,
        "PADDED_BLOCK_SIZE": pack.padded_block_size,
        "SLOT_WIDTH": pack.padded_block_size * (2 if features_beside else 1),
        **{f"{name.upper()}_TEXEL": glsl_vec3(1.0 / side for side in size) for name, size in sizes.items()},
        **{f"COLOUR_STOP_{i}": glsl_vec3(stop) for i, stop in enumerate(COLOUR_STOPS)},
        "CELL": CELL,
        # Content comes in runs, so a second sample is rarely for nothing; but with features it costs too much. The
        # cost modes take the steps that the picture takes.
        "SAMPLES_A_TEST": 1 if accumulates_features or (stored and mode in COST_MODES) else 2,
        "NDC": pack.ndc,
        "CONTRACTED": pack.contraction is not None and mode != "atlas",
        "DISTORTION": distortion,
        "ORTHOGRAPHIC": orthographic,
        "FEATURES_STORED": stored,
        "FEATURES_BESIDE": features_beside,
        "ACCUMULATE_FEATURES": accumulates_features,
        "VIEW_MLP": shaded,
        "VIEW_MLP_PER_SAMPLE": shaded and settings.view_mlp_per_sample,
        "ACCUMULATE_NORMAL": mode == "normals",
        "RAW": settings.raw,
        "LOOK": settings.look is not None and mode in MODES_WITH_LOOK,
        "OVER_BACKGROUND": int(mode in MODES_OVER_BACKGROUND),
        "BACKDROP": _style(settings) != "",
        "BACKDROP_CHECKER": _style(settings) == "checker",
    }


def shades_hull_alone(pack: Pack, settings: RenderSettings) -> bool:
    """Whether only pixels that see the hull of all content are shaded, where no lens bends the rays."""
    straight = not pack.ndc and pack.contraction is None
    return settings.marcher == "exact" and settings.mode != "atlas" and straight


def look_uniforms(look: Look | None) -> dict[str, Any]:
    """Of shaders/look.glsl."""
    return {} if look is None else {"look_gain": look.gain, "look_saturation": look.saturation}


def _style(settings: RenderSettings) -> str:
    """Which backdrop is seen; "" for none."""
    if settings.backdrop is None or settings.mode not in MODES_OVER_BACKGROUND or settings.raw:
        return ""
    return settings.backdrop.style
