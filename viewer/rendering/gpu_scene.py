"""A pack on the graphics card: textures for the marchers, in the tightest atlas that the driver's limits allow.

Notation: B = padded block size; n = occupied macroblocks; a slot is a macroblock's place in the repacked atlas, (x, y, z).
The pack's own atlas layout is not kept: occupied macroblocks are copied, in the grid's order, into an atlas with next to
no empty slots. Two layouts of textures, for the marchers that need them:
  exact, brute: indirection (RGBA8UI), skip words (R16UI), and one atlas in which the features of each macroblock lie
                beside its rgba in x, so that a sample's two fetches meet the same pages of memory; or, where a texture
                so large is refused, an atlas of rgba and one of features
  paper:        indirection, alpha (R8), rgb (RGB8), features, and the view MLP's weights (SNeRG paper, appendix A)
Textures are allocated at once and may be filled bit by bit: macroblocks that have not arrived count as empty.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from math import ceil, inf

import moderngl
import numpy as np

from scenepack.pack import Pack
from viewer.rendering.gpu_memory import Limits, NoRoomError, Uploader
from viewer.rendering.skip_grid import skip_grid_of
from viewer.rendering.software_rasteriser import (
    Range,
    memory_taken_since,
    move_to_huge_pages,
    private_memory,
    software_draws,
)

MAX_SLOTS = 256  # along an axis: the indirection grid holds bytes
SHOWN_EVERY_S = 0.02  # while a pack arrives
TOLERATED_WASTE = 1.01  # empty slots that are worth a layout with better locality

Triple = tuple[int, int, int]


@dataclass
class GpuScene:
    """A pack on the GPU, and what the uniforms must know."""

    textures: dict[str, moderngl.Texture | moderngl.Texture3D]  # by the name of their sampler in the shaders
    samplers: dict[str, moderngl.Sampler]  # likewise
    features_beside: bool  # features lie beside rgba in one atlas, a macroblock's side further in x
    content_min: np.ndarray  # float64 [3], voxels, of the box around all content
    content_max: np.ndarray
    hull: moderngl.Buffer | None  # its triangles' corners, where the layout has them and there are any
    gpu_bytes: int
    writer: AtlasWriter  # what fills the textures
    arriving: Iterator[None] | None  # its steps; None once all is there

    @property
    def cube_side(self) -> int:
        """Macroblocks along a side of the smallest cube that holds all of them."""
        return next(n for n in range(1, 1000) if n**3 >= len(self.writer.places))

    @property
    def sizes(self) -> dict[str, Triple]:
        """Texels (x, y, z) of the atlas, the indirection and, where the layout has one, the skip grid."""
        grids = {name: self.textures[name].size for name in ("indirection", "skip_grid") if name in self.textures}
        return {"atlas": self.writer.size, **grids}

    def arrive(self, seconds: float = inf) -> bool:
        """Fills the textures for about `seconds`; True where all has arrived. NoRoomError where the driver gives up."""
        end = time.perf_counter() + seconds
        while self.arriving is not None:
            if next(self.arriving, self) is self:
                self.arriving = None
            if time.perf_counter() >= end:
                break
        return self.arriving is None

    def bind(self, program: moderngl.Program) -> None:
        """Binds every texture that `program` samples, and its sampler, to a unit of its own."""
        unit = 0
        for name, texture in self.textures.items():
            if name in program:
                program[name] = unit
                texture.use(unit)
                self.samplers[name].use(unit)
                unit += 1

    def unbind(self, ctx: moderngl.Context) -> None:
        """Takes our samplers off the texture units, which imgui uses too."""
        ctx.clear_samplers(0, len(self.textures))

    def release(self) -> None:
        for thing in {id(thing): thing for thing in (*self.textures.values(), *self.samplers.values())}.values():
            thing.release()
        if self.hull is not None:
            self.hull.release()
        self.textures, self.samplers, self.hull, self.arriving = {}, {}, None, None


def tightest_atlas(count: int, padded_block_size: int, max_side: int, parts: int = 1) -> Triple:
    """Slots (x, y, z) for `count` macroblocks, within a hundredth of the fewest, narrowest in x, then in y.

    Narrow, because drivers that do not tile 3D textures (Mesa's software one) store them x fastest: a macroblock's rows
    then lie side by side, which is worth a tenth of a frame. max_side: voxels, GL_MAX_3D_TEXTURE_SIZE. parts: voxels of
    as many atlases side by side along x.
    NoRoomError where `count` do not fit.
    """
    side = min(max_side // padded_block_size, MAX_SLOTS)
    count = max(count, 1)
    layouts = [(x, y, ceil(count / (x * y))) for x in range(1, side // parts + 1) for y in range(1, side + 1)]
    layouts = [layout for layout in layouts if layout[2] <= side]
    if not layouts:
        raise NoRoomError(
            "the pack is too large for this graphics driver",
            expected=f"at most {side**3} occupied macroblocks of {padded_block_size}³ voxels",
            found=str(count),
            remedy="bake at a lower resolution",
        )
    fewest = min(x * y * z for x, y, z in layouts)
    return min((x, y, z) for x, y, z in layouts if x * y * z <= TOLERATED_WASTE * fewest)


def indirection_grid(occupied: np.ndarray, slots: Triple, arrived: np.ndarray | None = None) -> np.ndarray:
    """uint8 [z + 2, y + 2, x + 2, 4]: slot (x, y, z) and 0, or 1 in the last for empty, as the border is.

    occupied: bool [blocks z, y, x]; they take the atlas's slots in this order. arrived: bool, layers of slots that are filled
    (None: all); macroblocks that have not arrived count as empty.
    """
    nx, ny, nz = slots
    order = np.arange(int(occupied.sum()))
    layer = order // (nx * ny)
    arrived = np.ones(nz, bool) if arrived is None else arrived
    grid = np.zeros((*(n + 2 for n in occupied.shape), 4), np.uint8)
    grid[..., 3] = 1
    grid[1:-1, 1:-1, 1:-1][occupied] = np.stack([order % nx, order // nx % ny, layer, ~arrived[layer]], axis=1)
    return grid


def float_sampler(ctx: moderngl.Context) -> moderngl.Sampler:
    """Trilinear filtering in floating point.

    Mesa's software rasteriser blends 8-bit texels in 8-bit arithmetic, except where the wrap mode is an unusual one;
    asking for a border colour (which no fetch of ours ever reaches) costs a little more there and nothing elsewhere.
    """
    sampler = ctx.sampler(filter=(moderngl.LINEAR, moderngl.LINEAR))
    sampler.border_color = (0.0, 0.0, 0.0, 0.0)
    sampler.repeat_x = sampler.repeat_y = False  # along one axis it is enough, and compares a third of the coordinates
    return sampler


def clamped_sampler(ctx: moderngl.Context, kind: int) -> moderngl.Sampler:
    """Filtering of a kind (moderngl.LINEAR, NEAREST) as a driver does it by itself, clamped to the edge."""
    return ctx.sampler(filter=(kind, kind), repeat_x=False, repeat_y=False, repeat_z=False)


Part = tuple[np.ndarray, slice]  # channels of one of the pack's atlases


class AtlasWriter:
    """Repacks a pack's macroblocks into textures of one layout; `beside`: parts of an atlas side by side in each.

    near: a point of the grid, in voxels; layers of slots close to it arrive first. None: in the grid's order.
    """

    def __init__(self, uploader: Uploader, pack: Pack, beside: int = 1) -> None:
        self.uploader, self.pack, self.block = uploader, pack, pack.padded_block_size
        self.near: np.ndarray | None = None
        self.places = pack.atlas_indices[pack.occupied].astype(np.intp) * self.block  # in the pack's atlas, (x, y, z)
        self.slots = tightest_atlas(len(self.places), self.block, uploader.limits.max_side, beside)
        self.size = atlas_size(self.slots, self.block, beside)
        nx, ny, nz = self.slots
        self.textures: list[tuple[str, moderngl.Texture3D, tuple[Part, ...]]] = []
        self._layer_of = np.arange(len(self.places)) // (nx * ny)  # of each macroblock, in the grid's order
        self._arrived = np.zeros(nz, bool)  # layers of slots
        self.indirection = uploader.filled("indirection", self._indirection())

    def _indirection(self) -> np.ndarray:
        return indirection_grid(self.pack.occupied, self.slots, self._arrived)

    def texture(self, name: str, *parts: Part) -> moderngl.Texture3D:
        """An empty texture for `parts`, side by side in x; steps() fills it."""
        channels = max(len(range(atlas.shape[3])[chosen]) for atlas, chosen in parts)
        texture = self.uploader.volume(name, self.size, channels)
        self.textures.append((name, texture, parts))
        return texture

    def steps(self) -> Iterator[None]:
        """Fills all textures, one layer of slots at a time, and shows the macroblocks of each from then on."""
        shown = time.perf_counter()
        while not self._arrived.all():
            layer = self._next_layer()
            for name, texture, parts in self.textures:
                self._write(layer, name, texture, parts)
            self._arrived[layer] = True
            if time.perf_counter() - shown > SHOWN_EVERY_S or self._arrived.all():
                self.show_arrived()
                shown = time.perf_counter()
            yield

    def rewrite(self, numbers: Sequence[int]) -> None:
        """Writes macroblocks, by their number in the grid's order, again: the pack's atlas has changed there."""
        nx, ny, _ = self.slots
        size = self.block
        for number in numbers:
            x, y, z = self.places[number].tolist()
            slot = number % nx, number // nx % ny, number // (nx * ny)
            for _, texture, parts in self.textures:
                wide = size * len(parts)
                cubes = [atlas[z : z + size, y : y + size, x : x + size, chosen] for atlas, chosen in parts]
                viewport = (slot[0] * wide, slot[1] * size, slot[2] * size, wide, size, size)
                texture.write(np.concatenate(cubes, axis=2), viewport=viewport, alignment=1)

    def show_arrived(self) -> None:
        """Lets rays see the macroblocks that have arrived."""
        self.indirection.write(self._indirection(), alignment=1)

    def _next_layer(self) -> int:
        """The layer whose nearest macroblock is closest to `near`, of those that have not arrived."""
        coming = np.flatnonzero(~self._arrived)
        if self.near is None or not len(self.places):
            return int(coming[0])
        middles = (np.argwhere(self.pack.occupied)[:, ::-1] + 0.5) * self.pack.block_size
        away = np.full(len(self._arrived), inf)
        np.minimum.at(away, self._layer_of, np.square(middles - self.near).sum(axis=1))
        return int(coming[np.argmin(away[coming])])

    def _write(self, layer: int, name: str, texture: moderngl.Texture3D, parts: tuple[Part, ...]) -> None:
        nx, ny, _ = self.slots
        width, height, _ = self.size
        size = self.block
        volume = np.zeros((size, height, width, texture.components), np.uint8)
        for slot, (x, y, z) in enumerate(self.places[layer * nx * ny : (layer + 1) * nx * ny].tolist()):
            to_y = slot // nx * size
            for k, (atlas, channels) in enumerate(parts):
                to_x = (slot % nx * len(parts) + k) * size
                block = atlas[z : z + size, y : y + size, x : x + size, channels]
                volume[:, to_y : to_y + size, to_x : to_x + size] = block
        texture.write(volume, viewport=(0, 0, layer * size, width, height, size), alignment=1)
        self.uploader.check(f"the {name} texture", int(np.prod(self.size, dtype=np.int64)) * volume.shape[3])


def atlas_size(slots: Triple, block: int, parts: int) -> Triple:
    """Voxels (x, y, z) of an atlas of `slots` macroblocks of `block` voxels a side, `parts` of them side by side in x."""
    return slots[0] * parts * block, slots[1] * block, slots[2] * block


def features_stored(pack: Pack) -> bool:
    """Whether the GPU holds the features of `pack`."""
    return pack.atlas_features is not None and pack.view_mlp is not None


def upload(
    ctx: moderngl.Context, pack: Pack, layout: str, limits: Limits | None = None, *, at_once: bool = True
) -> GpuScene:
    """Puts `pack` on the GPU for the marchers of `layout`, "exact" or "paper". NoRoomError where it does not fit.

    at_once: fill the textures, too; otherwise GpuScene.arrive does it, and what is there can be drawn meanwhile.
    """
    if layout == "exact" and features_stored(pack):
        try:
            return _uploaded(Uploader(ctx, limits), pack, layout, True, at_once)
        except NoRoomError:  # as two textures it may fit
            pass
    return _uploaded(Uploader(ctx, limits), pack, layout, False, at_once)


def _uploaded(uploader: Uploader, pack: Pack, layout: str, features_beside: bool, at_once: bool) -> GpuScene:
    taken_before = private_memory() if software_draws(uploader.ctx) else None
    try:
        scene = _allocate(uploader, pack, layout, features_beside)
        if taken_before is not None and scene.arriving is not None:
            scene.arriving = chain(scene.arriving, _moved_to_huge_pages(taken_before))
        if at_once:
            scene.arrive()
        return scene
    except BaseException:
        uploader.give_up()
        raise


def _moved_to_huge_pages(taken_before: list[Range]) -> Iterator[None]:
    yield from move_to_huge_pages(memory_taken_since(taken_before))  # asked once all has arrived


def _allocate(uploader: Uploader, pack: Pack, layout: str, features_beside: bool) -> GpuScene:
    ctx, every = uploader.ctx, slice(None)
    writer = AtlasWriter(uploader, pack, 2 if features_beside else 1)
    features = pack.atlas_features if pack.view_mlp is not None else None
    linear = clamped_sampler(ctx, moderngl.LINEAR) if layout == "paper" else float_sampler(ctx)
    nearest = clamped_sampler(ctx, moderngl.NEAREST)
    textures: dict[str, moderngl.Texture | moderngl.Texture3D] = {"indirection": writer.indirection}
    content_min = content_max = np.zeros(3)
    hull = None
    if layout == "paper":
        textures["atlas_alpha"] = writer.texture("alpha", (pack.atlas_rgba, slice(3, 4)))
        textures["atlas_alpha_nearest"] = textures["atlas_alpha"]
        textures["atlas_rgb"] = writer.texture("rgb", (pack.atlas_rgba, slice(0, 3)))
        for layer, matrix in enumerate(pack.view_mlp.weights if pack.view_mlp else ()):
            textures[f"weights_{layer}"] = uploader.weights(matrix)
    elif features_beside and features is not None:
        textures["atlas_rgba"] = writer.texture("rgba and feature", (pack.atlas_rgba, every), (features, every))
    else:
        textures["atlas_rgba"] = writer.texture("rgba", (pack.atlas_rgba, every))
    if features is not None and not features_beside:
        textures["atlas_features"] = writer.texture("feature", (features, every))
    if layout != "paper":  # last, for it takes time: a pack that does not fit has been refused by now
        skip_grid = skip_grid_of(pack)
        content_min, content_max = skip_grid.content_min, skip_grid.content_max
        hull = ctx.buffer(skip_grid.hull.tobytes()) if len(skip_grid.hull) else None
        textures["skip_grid"] = uploader.filled("skip distance", skip_grid.words[..., None], "u2")
    filtered = ("atlas_alpha", "atlas_rgb", "atlas_rgba", "atlas_features")
    samplers = {name: linear if name in filtered else nearest for name in textures}
    return GpuScene(
        textures, samplers, features_beside, content_min, content_max, hull, uploader.bytes, writer, writer.steps()
    )
