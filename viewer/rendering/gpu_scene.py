"""A pack on the graphics card: textures for the marchers, in the tightest atlas that the driver allows; packs halved to fit.

Notation: B = padded block size; n = occupied macroblocks; a slot is a macroblock's place in the repacked atlas, (x, y, z).
The pack's own atlas layout is not kept: occupied macroblocks are copied, in the grid's order, into an atlas with next to
no empty slots. Two layouts of textures, for the marchers that need them:
  exact, brute: indirection (RGBA8UI), skip words (R16UI), and one atlas in which the features of each macroblock lie
                beside its rgba in x, so that a sample's two fetches meet the same pages of memory; or, where a texture
                so large is refused, an atlas of rgba and one of features
  paper:        indirection, alpha (R8), rgb (RGB8), features, and the view MLP's weights (SNeRG paper, appendix A)
Textures are allocated at once and may be filled bit by bit: macroblocks that have not arrived count as empty.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from math import ceil, inf

import moderngl
import numpy as np

from console import UserError
from scenepack.blocks import Triple, atlas_layout, block_copy, dense_from_pack, grid_block_counts, with_macroblocks
from scenepack.pack import Pack
from viewer.rendering import software_rasteriser as software
from viewer.rendering.skip_grid import skip_grid_of

MAX_SLOTS = 256  # along an axis: the indirection grid holds bytes
SHOWN_EVERY_S = 0.02  # while a pack arrives
TOLERATED_WASTE = 1.01  # empty slots that are worth a layout with better locality
OR_HALF = "or measure it at half resolution: --allow-half"  # the remedy of commands that have this option


class NoRoomError(UserError):
    """A pack does not fit on the graphics card."""


class GpuScene:
    """A pack on the GPU, its macroblocks repacked, and what the uniforms must know. Textures are empty until arrive() fills them.

    layout: of the textures, "exact" or "paper". features_beside: features lie beside rgba in one atlas, a macroblock's side
    further in x. at_once: call arrive() now. NoRoomError where it does not fit.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        pack: Pack,
        layout: str,
        *,
        features_beside: bool = False,
        at_once: bool = True,
    ) -> None:
        self.ctx, self.pack, self.features_beside = ctx, pack, features_beside
        self.gpu_bytes = 0
        block, beside = pack.padded_block_size, 2 if features_beside else 1
        self.blocks = np.argwhere(pack.occupied)  # (z, y, x), in the grid's order
        self.slots = tightest_atlas(len(self.blocks), block, largest_texture_side(ctx), beside)
        self.size = atlas_size(self.slots, block, beside)
        self.near: np.ndarray | None = None  # a point of the grid, voxels: layers of slots close to it arrive first
        self.textures: dict[str, moderngl.Texture | moderngl.Texture3D] = {}  # by the name of their sampler
        self.samplers: dict[str, moderngl.Sampler] = {}  # likewise
        self._atlases: list[tuple[str, moderngl.Texture3D, tuple[np.ndarray, ...]]] = []  # what lies side by side in x
        self._arrived = np.zeros(self.slots[2], bool)  # layers of slots
        # Earlier errors of others; some drivers leave one when the context is created
        while ctx.error != "GL_NO_ERROR":
            pass
        taken_before = software.huge_pages() if software.software_draws(ctx) else None
        self.arriving: Iterator[None] | None = self._fill(taken_before)  # its steps; None once all is there
        try:
            self._allocate(layout)
            if at_once:
                self.arrive()
        except BaseException:
            self.release()
            raise

    def _allocate(self, layout: str) -> None:
        ctx, pack = self.ctx, self.pack
        features = pack.atlas_features if pack.view_mlp is not None else None
        self._filled("indirection", "indirection", self._indirection())
        if layout == "paper":
            self._atlas("atlas_alpha", "alpha", pack.atlas_rgba[..., 3:])
            self.textures["atlas_alpha_nearest"] = self.textures["atlas_alpha"]
            self._atlas("atlas_rgb", "rgb", pack.atlas_rgba[..., :3])
            for layer, matrix in enumerate(pack.view_mlp.weights if pack.view_mlp else ()):
                self._weights(f"weights_{layer}", matrix)
        elif self.features_beside and features is not None:
            self._atlas("atlas_rgba", "rgba and feature", pack.atlas_rgba, features)
        else:
            self._atlas("atlas_rgba", "rgba", pack.atlas_rgba)
        if features is not None and not self.features_beside:
            self._atlas("atlas_features", "feature", features)
        if layout != "paper":  # last, for it takes time: a pack that does not fit has been refused by now
            self._filled("skip_grid", "skip distance", skip_grid_of(pack).words[..., None], "u2")
        linear = clamped_sampler(ctx, moderngl.LINEAR) if layout == "paper" else float_sampler(ctx)
        nearest = clamped_sampler(ctx, moderngl.NEAREST)
        filtered = ("atlas_alpha", "atlas_rgb", "atlas_rgba", "atlas_features")
        self.samplers = {name: linear if name in filtered else nearest for name in self.textures}

    # Textures. name: of the sampler; what: for messages.

    def _check(self, what: str, size: int) -> None:
        error = self.ctx.error
        if error != "GL_NO_ERROR":
            raise NoRoomError(
                f"the graphics driver has no room for {what}",
                expected=f"{size / 2**20:.0f} MiB of texture memory",
                found=error,
                remedy="close other programs, or bake at a lower resolution",
            )

    def _volume(self, name: str, what: str, size: Triple, channels: int, dtype: str = "u1") -> moderngl.Texture3D:
        """An uninitialised 3D texture of size (x, y, z)."""
        bytes_ = int(np.prod(size, dtype=np.int64)) * channels * int(dtype[-1])
        texture = self.textures[name] = self.ctx.texture3d(size, channels, alignment=1, dtype=dtype)
        self._check(f"the {what} texture", bytes_)
        self.gpu_bytes += bytes_
        return texture

    def _filled(self, name: str, what: str, data: np.ndarray, dtype: str = "u1") -> None:
        """A 3D texture of integers from data [z, y, x, channels]."""
        z, y, x, channels = data.shape
        self._volume(name, what, (x, y, z), channels, dtype).write(np.ascontiguousarray(data), alignment=1)

    def _atlas(self, name: str, what: str, *parts: np.ndarray) -> None:
        """An empty texture for `parts`, atlases of the pack or channels of one, side by side in x."""
        self._atlases.append((what, self._volume(name, what, self.size, parts[0].shape[3], "f1"), parts))

    def _weights(self, name: str, matrix: np.ndarray) -> None:
        """matrix [inputs, outputs] as float RGBA texels, outputs padded to whole texels."""
        inputs, outputs = matrix.shape
        padded = np.pad(matrix.astype(np.float32), [(0, 0), (0, -outputs % 4)])
        self.textures[name] = self.ctx.texture((padded.shape[1] // 4, inputs), 4, padded.tobytes(), dtype="f4")
        self._check("the view MLP's weights", padded.nbytes)
        self.gpu_bytes += padded.nbytes

    # Filling them

    def arrive(self, seconds: float = inf) -> bool:
        """Fills the textures for about `seconds`; True where all has arrived. NoRoomError where the driver gives up."""
        end = time.perf_counter() + seconds
        for _ in self.arriving or ():
            if time.perf_counter() >= end:
                return False
        self.arriving = None
        return True

    def _fill(self, taken_before: set[int] | None) -> Iterator[None]:
        """One layer of slots at a time, whose macroblocks are shown from then on."""
        shown = time.perf_counter()
        while not self._arrived.all():
            layer, slots = self._next_layer(), self.slots[0] * self.slots[1]
            self.rewrite(range(layer * slots, min((layer + 1) * slots, len(self.blocks))))
            for what, texture, _ in self._atlases:
                self._check(f"the {what} texture", int(np.prod(self.size, dtype=np.int64)) * texture.components)
            self._arrived[layer] = True
            if time.perf_counter() - shown > SHOWN_EVERY_S or self._arrived.all():
                self.textures["indirection"].write(self._indirection(), alignment=1)
                shown = time.perf_counter()
            yield
        if taken_before is not None:
            yield from software.move_to_huge_pages(sorted(software.huge_pages() - taken_before))

    def _next_layer(self) -> int:
        """The layer of the macroblock closest to `near`, of those that have not arrived."""
        if self.near is None or not len(self.blocks):
            return int(np.argmin(self._arrived))
        layers = np.arange(len(self.blocks)) // (self.slots[0] * self.slots[1])  # of each macroblock
        middles = (self.blocks[:, ::-1] + 0.5) * self.pack.block_size
        away = np.square(middles - self.near).sum(axis=1)
        return int(layers[np.argmin(np.where(self._arrived[layers], inf, away))])

    def _indirection(self) -> np.ndarray:
        """Of the macroblocks that have arrived."""
        return indirection_grid(self.pack.occupied, self.slots, self._arrived)

    def rewrite(self, numbers: Sequence[int]) -> None:
        """Copies macroblocks, by their number in the grid's order, from the pack: first, and where its atlas has changed."""
        nx, ny, _ = self.slots
        size = self.pack.padded_block_size
        for number in numbers:
            block, slot = tuple(self.blocks[number]), (number % nx, number // nx % ny, number // (nx * ny))
            for _, texture, parts in self._atlases:
                wide = size * len(parts)
                cubes = [block_copy(self.pack, part, block) for part in parts]
                viewport = (slot[0] * wide, slot[1] * size, slot[2] * size, wide, size, size)
                texture.write(np.concatenate(cubes, axis=2), viewport=viewport, alignment=1)

    # Drawing with them

    @property
    def sizes(self) -> dict[str, Triple]:
        """Texels (x, y, z) of the atlas, the indirection and, where the layout has one, the skip grid."""
        grids = {name: self.textures[name].size for name in ("indirection", "skip_grid") if name in self.textures}
        return {"atlas": self.size, **grids}

    def bind(self, program: moderngl.Program) -> None:
        """Binds every texture that `program` samples, and its sampler, to a unit of its own."""
        unit = 0
        for name, texture in self.textures.items():
            if name in program:
                program[name] = unit
                texture.use(unit)
                self.samplers[name].use(unit)
                unit += 1

    def release(self) -> None:
        for thing in {*self.textures.values(), *self.samplers.values()}:
            thing.release()
        self.textures, self.samplers, self.arriving = {}, {}, None


def largest_texture_side(ctx: moderngl.Context) -> int:
    """The most texels along a side of a 3D texture. Drivers do not tell how many bytes a texture may have: they refuse it."""
    return ctx.info["GL_MAX_3D_TEXTURE_SIZE"]


def upload(ctx: moderngl.Context, pack: Pack, layout: str, *, at_once: bool = True) -> GpuScene:
    """The scene with its features beside rgba where it has any and that fits; otherwise as GpuScene."""
    if layout == "exact" and features_stored(pack):
        with suppress(NoRoomError):  # as two textures it may fit
            return GpuScene(ctx, pack, layout, features_beside=True, at_once=at_once)
    return GpuScene(ctx, pack, layout, at_once=at_once)


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
    slot = atlas_layout(occupied, slots)[occupied]
    missing = np.zeros(len(slot), bool) if arrived is None else ~arrived[slot[:, 2]]
    grid = np.zeros((*(n + 2 for n in occupied.shape), 4), np.uint8)
    grid[..., 3] = 1
    grid[1:-1, 1:-1, 1:-1][occupied] = np.column_stack([slot, missing])
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


def atlas_size(slots: Triple, block: int, parts: int) -> Triple:
    """Voxels (x, y, z) of an atlas of `slots` macroblocks of `block` voxels a side, `parts` of them side by side in x."""
    return slots[0] * parts * block, slots[1] * block, slots[2] * block


def features_stored(pack: Pack) -> bool:
    """Whether the GPU holds the features of `pack`."""
    return pack.atlas_features is not None and pack.view_mlp is not None


# --- Half resolution ---


def half_resolution(pack: Pack) -> Pack:
    """`pack` with voxels of twice the side, in the same place; the grid's far faces may lie one old voxel farther out.

    Each voxel stands for 2^3 of the whole pack, the last of an odd side for those it has. Its premultiplied colour, features and
    opacity a are their mean. A ray takes half as many samples, each of which must do the work of two, one behind the other:
    c + (1 - a) c and a + (1 - a) a, both 2 - a times the mean. The block size stays, so that the padding, which is made anew from
    the neighbours, takes no greater share.
    """
    x, y, z = (-(-side // 2) for side in pack.grid_size)
    grid_size = (x, y, z)
    occupied = np.zeros(grid_block_counts(grid_size, pack.block_size)[::-1], bool)
    bz, by, bx = np.nonzero(pack.occupied)
    occupied[bz // 2, by // 2, bx // 2] = True  # along each axis, macroblocks 2 i and 2 i + 1 make the new one i
    size, side = pack.block_size, 2 * pack.block_size

    def halved(block: tuple[int, ...]) -> tuple[tuple[int, ...], np.ndarray]:
        z, y, x = (side * i for i in block)
        whole = dense_from_pack(pack, ((x, y, z), (x + side, y + side, z + side)))
        voxels = np.concatenate([part for part in whole if part is not None], axis=-1)
        means = voxels.reshape(size, 2, size, 2, size, 2, -1).mean(axis=(1, 3, 5), dtype=np.float32)
        gain = 2.0 - means[..., 3:4] / 255.0
        return block, np.rint(np.minimum(means * gain, 255.0)).astype(np.uint8)

    blocks = map(halved, map(tuple, np.argwhere(occupied).tolist()))
    coarse = replace(pack, voxel_size=2.0 * pack.voxel_size, grid_size=grid_size)
    return with_macroblocks(coarse, blocks, occupied)
