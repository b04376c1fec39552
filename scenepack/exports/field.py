"""Voxels as a field that is read box by box, and the frame of an exported file.

Notation: f: voxels of the pack along the side of one of the field's; *cells* are the field's voxels, whose centre i is at grid
position f (i + 0.5). A coarser cell takes the mean of its f^3 voxels; a ray meets 1/f as many, so that its opacity a becomes
1 - (1 - a)^f, as in scenepack.coarse, rounded to 8 bits.

Frames. grid: the pack's OpenGL frame, y up (docs/format.md, "Coordinate frames"). world: the training frame, that of the poses.
Both have the scene's own units. placed: the grid frame as people have moved it, in their unit (scenepack.placement). In a
forward-facing pack positions are those before the NDC warp (NeRF, appendix C):
  x_ndc = -(2 f / w) x / z,  y_ndc = -(2 f / h) y / z,  z_ndc = 1 + 2 n / z,  with n = NDC_NEAR.
In a contracted pack they are those of space (scenepack.contraction), and u is a grid position in units of R.
"""

from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np

from scenepack.blocks import block_data
from scenepack.constants import NDC_NEAR
from scenepack.contraction import uncontract
from scenepack.pack import Pack
from scenepack.placement import placed_T_grid, transformed

Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
Place = tuple[int, int, int]
OnShare = Callable[[float], None]
# Components of a surface: all, the largest, or those with this share of its area
Keep = Literal["all", "largest"] | float


def straight_colours(rgba: np.ndarray) -> np.ndarray:
    """[n, 3] in 0 ... 1 of premultiplied rgba [n, 4]."""
    return np.clip(rgba[:, :3] / np.maximum(rgba[:, 3:], 1e-6), 0.0, 1.0)


class Field:
    """crop: corners (min, max) of a box in the grid frame; voxels whose centre is not in it are empty."""

    def __init__(self, pack: Pack, coarser: int = 1, crop: Corners | None = None) -> None:
        self.pack, self.coarser = pack, coarser
        self.side = pack.block_size // coarser  # of a macroblock, in cells
        self._low, self._high = np.zeros(3, int), np.asarray(pack.grid_size[::-1])
        self._coarse: dict[Place, np.ndarray] = {}  # small, and each is asked for up to eight times
        if crop is not None:
            corners = (np.sort(np.asarray(crop, np.float64), axis=0) - pack.min_xyz) / pack.voxel_size
            inside = np.ceil(corners - 0.5).astype(np.int64)[:, ::-1]
            self._low, self._high = np.maximum(inside[0], self._low), np.minimum(inside[1], self._high)

    @cached_property
    def occupied(self) -> list[Place]:
        """Macroblocks (z, y, x) that hold something within the crop box."""
        size = self.pack.block_size
        places = np.argwhere(self.pack.occupied)
        reached = np.all((places * size < self._high) & ((places + 1) * size > self._low), axis=1)
        return [(z, y, x) for z, y, x in places[reached].tolist()]

    def block(self, place: Place) -> np.ndarray:
        """Premultiplied rgba, float32 [side, side, side, 4] in 0 ... 1, of an occupied macroblock."""
        if place in self._coarse:
            return self._coarse[place]
        voxels = block_data(self.pack, self.pack.atlas_rgba, place).astype(np.float32) / 255.0
        size, f = self.pack.block_size, self.coarser
        for axis in range(3):
            index = place[axis] * size + np.arange(size)
            outside = (index < self._low[axis]) | (index >= self._high[axis])
            if outside.any():
                voxels[(slice(None),) * axis + (outside,)] = 0.0
        if f == 1:
            return voxels
        mean = voxels / f**3
        for axis in range(3):  # strided sums are several times as fast as a mean over three axes
            mean = np.add.reduce([mean[(slice(None),) * axis + (slice(i, None, f),)] for i in range(f)])
        alpha = mean[..., 3:]
        grown = np.rint(255.0 * (1.0 - (1.0 - np.minimum(alpha, 1.0)) ** f)) / 255.0
        self._coarse[place] = (mean * grown / np.maximum(alpha, 1e-9)).astype(np.float32)
        return self._coarse[place]

    def boxes(self, on_progress: OnShare) -> Iterator[tuple[Place, np.ndarray]]:
        """Boxes whose cubes of neighbouring cells are all cubes that something lies in, each once: a macroblock's cells and one
        more on its far sides, float32 [side + 1, ...]."""
        steps, held = list(product((0, 1), repeat=3)), set(self.occupied)
        places = sorted({(z - dz, y - dy, x - dx) for z, y, x in held for dz, dy, dx in steps})
        for done, (z, y, x) in enumerate(places):
            on_progress(done / len(places))
            box = np.zeros((*(self.side + 1,) * 3, 4), np.float32)
            for step in steps:
                if (place := (z + step[0], y + step[1], x + step[2])) in held:
                    to = tuple(slice(self.side, None) if s else slice(0, self.side) for s in step)
                    box[to] = self.block(place)[tuple(slice(0, 1) if s else slice(None) for s in step)]
            yield (z, y, x), box


# --- Export frame ---

Frame = Literal["placed", "grid", "world"]
FARTHEST_CONTRACTED = 1.98  # |u|∞; 50 R away
FARTHEST_NDC = 0.98  # z_ndc; beyond it, 100 near planes away, a voxel is deeper than a near plane and infinity is close


class ExportFrame:
    """Converts grid positions (voxels) to `frame`, scaled by `scale`."""

    def __init__(self, pack: Pack, frame: Frame = "grid", scale: float = 1.0) -> None:
        self.pack, self.scale = pack, scale
        self._training_T_grid = np.asarray(pack.worldspace_T_opengl, np.float64)
        frame_T_training = np.eye(4) if frame == "world" else np.linalg.inv(self._training_T_grid)
        if frame == "placed":
            frame_T_training = placed_T_grid(pack) @ frame_T_training
        self._frame_T_grid = frame_T_training @ self._training_T_grid
        self._frame_T_training = frame_T_training

    def near_enough(self, positions: np.ndarray) -> np.ndarray:
        """bool [n]: whether positions [n, 3] (x, y, z in voxels) are places of space, and not next to infinity."""
        if self.pack.contraction is not None:
            sizes = np.sort(np.abs(self._contracted(positions)), axis=1)
            return (sizes[:, 1] <= 1.0) & (sizes[:, 2] <= FARTHEST_CONTRACTED)
        if not self.pack.ndc:
            return np.ones(len(positions), bool)
        return self._ndc(positions)[:, 2] <= FARTHEST_NDC

    def in_inner_cube(self, positions: np.ndarray) -> np.ndarray:
        """bool [n]: whether positions [n, 3] are not among the surroundings of a contracted pack."""
        if self.pack.contraction is None:
            return np.ones(len(positions), bool)
        return np.all(np.abs(self._contracted(positions)) <= 1.0, axis=1)

    def points(self, positions: np.ndarray) -> np.ndarray:
        """float64 [n, 3] of positions [n, 3] in voxels."""
        if self.pack.ndc:
            return self.scale * transformed(self._frame_T_training, _unwarped(self.pack, self._ndc(positions)))
        if self.pack.contraction is not None:
            grid = self.pack.contraction * uncontract(self._contracted(positions))
        else:
            grid = self.pack.min_xyz + self.pack.voxel_size * positions
        return self.scale * transformed(self._frame_T_grid, grid)

    def sizes(self, positions: np.ndarray) -> np.ndarray:
        """float64 [n, 3]: how long a voxel there is along x, y, z of the grid; in forward-facing packs before the warp, in
        contracted ones in space."""
        voxel = self.pack.voxel_size
        if not self.pack.ndc:
            sizes = np.full((len(positions), 3), voxel * self.stretch)
            if self.pack.contraction is not None:
                contracted = np.abs(self._contracted(positions))
                w = 1.0 / (2.0 - np.maximum(contracted.max(axis=1, keepdims=True), 1.0))
                sizes *= np.where(contracted > 1.0, w * w, w)
            return sizes
        z = _unwarped(self.pack, self._ndc(positions))[:, 2]
        width, height, focal = ndc_camera(self.pack)
        across, up = -z * width / (2 * focal), -z * height / (2 * focal)
        unit = abs(np.linalg.det(self._frame_T_training[:3, :3])) ** (1 / 3)
        return self.scale * unit * voxel * np.stack([across, up, z**2 / (2 * NDC_NEAR)], axis=1)

    @property
    def stretch(self) -> float:
        """How long a unit of the grid frame is."""
        return float(self.scale * np.abs(np.linalg.det(self._frame_T_grid[:3, :3])) ** (1 / 3))

    def pose(self, training_T_camera: np.ndarray) -> np.ndarray:
        """float64 [4, 4], a rotation and a place, of a camera in the training frame; axes x right, y up, z back.

        A frame that mirrors the training frame mirrors what the camera sees: left is right there.
        """
        pose = self._frame_T_training @ training_T_camera
        left, _, right = np.linalg.svd(pose[:3, :3])
        rotation = left @ right  # the closest one, or its mirror image
        if np.linalg.det(rotation) < 0:
            rotation[:, 0] *= -1.0
        frame_T_camera = np.eye(4)
        frame_T_camera[:3, :3], frame_T_camera[:3, 3] = rotation, self.scale * pose[:3, 3]
        return frame_T_camera

    @property
    def turned(self) -> np.ndarray:
        """float64 [3, 3]: the rotation of a box along the grid's axes; none where the frame mirrors the grid frame."""
        rotation = self._frame_T_grid[:3, :3] * self.scale / self.stretch
        return rotation if np.linalg.det(rotation) > 0 and not self.pack.ndc else np.eye(3)

    @property
    def mirrors(self) -> bool:
        """Whether the conversion reverses orientation, so that triangles must be turned. The NDC warp does so, too."""
        return bool(np.linalg.det(self._frame_T_grid[:3, :3]) < 0) != self.pack.ndc

    def _contracted(self, positions: np.ndarray) -> np.ndarray:
        """u, float64 [n, 3]."""
        assert self.pack.contraction is not None
        return (self.pack.min_xyz + self.pack.voxel_size * np.asarray(positions, np.float64)) / self.pack.contraction

    def _ndc(self, positions: np.ndarray) -> np.ndarray:
        grid = self.pack.min_xyz + self.pack.voxel_size * np.asarray(positions, np.float64)
        return transformed(self._training_T_grid, grid)


def ndc_camera(pack: Pack) -> tuple[float, float, float]:
    """Width, height and focal length, in pixels, of the photographs whose frustum the NDC cube is."""
    assert pack.input_width and pack.input_height and pack.input_focal
    return pack.input_width, pack.input_height, pack.input_focal


def _unwarped(pack: Pack, ndc: np.ndarray) -> np.ndarray:
    width, height, focal = ndc_camera(pack)
    z = 2.0 * NDC_NEAR / np.minimum(ndc[:, 2] - 1.0, -1e-9)
    return np.stack([-ndc[:, 0] * z * width / (2 * focal), -ndc[:, 1] * z * height / (2 * focal), z], axis=1)
