"""Export frame: converts grid positions to the frame of an exported file.

grid: the pack's OpenGL frame, y up (docs/format.md, "Coordinate frames"). world: the training frame, that of the poses.
Both have the scene's own units. In a forward-facing pack positions are those before the NDC warp (NeRF, appendix C):
  x_ndc = -(2 f / w) x / z,  y_ndc = -(2 f / h) y / z,  z_ndc = 1 + 2 n / z,  with n = NDC_NEAR.
In a contracted pack they are those of space (scenepack.contraction), and u is a grid position in units of R.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from scenepack.constants import NDC_NEAR, PUBLISHED_NDC_CAMERA
from scenepack.contraction import uncontract
from scenepack.pack import Pack

Frame = Literal["grid", "world"]
FARTHEST_CONTRACTED = 1.98  # |u|∞; 50 R away
FARTHEST_NDC = 0.98  # z_ndc; beyond it, 100 near planes away, a voxel is deeper than a near plane and infinity is close


class ExportFrame:
    """Converts grid positions (voxels) to `frame`, scaled by `scale`."""

    def __init__(self, pack: Pack, frame: Frame = "grid", scale: float = 1.0) -> None:
        self.pack, self.scale = pack, scale
        self._training_T_grid = np.asarray(pack.worldspace_T_opengl, np.float64)
        frame_T_training = np.eye(4) if frame == "world" else np.linalg.inv(self._training_T_grid)
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
            return self.scale * _moved(self._frame_T_training, _unwarped(self.pack, self._ndc(positions)))
        if self.pack.contraction is not None:
            grid = self.pack.contraction * uncontract(self._contracted(positions))
        else:
            grid = self.pack.min_xyz + self.pack.voxel_size * positions
        return self.scale * _moved(self._frame_T_grid, grid)

    def sizes(self, positions: np.ndarray) -> np.ndarray:
        """float64 [n, 3]: how long a voxel there is along x, y, z of the grid; in forward-facing packs before the warp, in
        contracted ones in space.
        """
        voxel = self.pack.voxel_size
        if not self.pack.ndc:
            stretch = np.abs(np.linalg.det(self._frame_T_grid[:3, :3])) ** (1 / 3)
            sizes = np.full((len(positions), 3), self.scale * voxel * stretch)
            if self.pack.contraction is not None:
                contracted = np.abs(self._contracted(positions))
                w = 1.0 / (2.0 - np.maximum(contracted.max(axis=1, keepdims=True), 1.0))
                sizes *= np.where(contracted > 1.0, w * w, w)
            return sizes
        z = _unwarped(self.pack, self._ndc(positions))[:, 2]
        width, height, focal = _ndc_camera(self.pack)
        across, up = -z * width / (2 * focal), -z * height / (2 * focal)
        return self.scale * voxel * np.stack([across, up, z**2 / (2 * NDC_NEAR)], axis=1)

    @property
    def mirrors(self) -> bool:
        """Whether the conversion reverses orientation, so that triangles must be turned."""
        if self.pack.ndc:  # measured on the warp itself
            probe = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) + 0.5 * np.asarray(self.pack.grid_size)
            placed = self.points(probe)
            return bool(np.linalg.det(placed[1:] - placed[0]) < 0)
        return bool(np.linalg.det(self._frame_T_grid[:3, :3]) < 0)

    def _contracted(self, positions: np.ndarray) -> np.ndarray:
        """u, float64 [n, 3]."""
        assert self.pack.contraction is not None
        return (self.pack.min_xyz + self.pack.voxel_size * np.asarray(positions, np.float64)) / self.pack.contraction

    def _ndc(self, positions: np.ndarray) -> np.ndarray:
        grid = self.pack.min_xyz + self.pack.voxel_size * np.asarray(positions, np.float64)
        return _moved(self._training_T_grid, grid)


def _ndc_camera(pack: Pack) -> tuple[float, float, float]:
    given = (pack.input_width, pack.input_height, pack.input_focal)
    width, height, focal = (
        old if value is None else float(value) for value, old in zip(given, PUBLISHED_NDC_CAMERA, strict=True)
    )
    return width, height, focal


def _unwarped(pack: Pack, ndc: np.ndarray) -> np.ndarray:
    width, height, focal = _ndc_camera(pack)
    z = 2.0 * NDC_NEAR / np.minimum(ndc[:, 2] - 1.0, -1e-9)
    return np.stack([-ndc[:, 0] * z * width / (2 * focal), -ndc[:, 1] * z * height / (2 * focal), z], axis=1)


def _moved(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]
