"""The frames a ray passes through, as uniforms of shaders/ray.glsl; in float64 until they reach the GPU.

Notation: "voxel" coordinates are (grid - min_xyz) / voxel_size; "training" is the frame the field was trained in, in
NDC packs before the warp; "ndc" after it. Source: docs/rendering.md and docs/format.md; NeRF, appendix C.
"""

from typing import Any

import numpy as np

from scenepack.exports.field import ndc_camera
from scenepack.pack import Pack
from training.scenes.lens import LENS_SIZE, REACH, whole_lens
from viewer.rendering.camera import ViewCamera, inner_box
from viewer.rendering.settings import RenderSettings


class RayFrame:
    """What rays must know of a pack, worked out once."""

    def __init__(self, pack: Pack) -> None:
        self.pack = pack
        self.training_T_grid = np.asarray(pack.worldspace_T_opengl, np.float64)
        self._whole = np.zeros(3), np.asarray(pack.grid_size, np.float64)
        self._inner = inner_box(pack)
        self.contraction = {}
        if pack.contraction is not None:
            self.contraction = {
                "contraction_centre": -pack.min_xyz / pack.voxel_size,
                "contraction_radius": pack.contraction / pack.voxel_size,
            }
        self.ndc = {}
        if pack.ndc:
            width, height, focal = ndc_camera(pack)
            rotation, _, rows = np.linalg.svd(self.training_T_grid[:3, :3])  # its orthogonal part, reflections included
            grid_T_ndc = np.linalg.inv(self.training_T_grid)
            self.ndc = {
                "ndc_scale": (2.0 * focal / width, 2.0 * focal / height),
                "training_R_grid": rotation @ rows,
                "voxel_R_ndc": grid_T_ndc[:3, :3] / pack.voxel_size,
                "voxel_t_ndc": (grid_T_ndc[:3, 3] - pack.min_xyz) / pack.voxel_size,
            }

    def uniforms(self, camera: ViewCamera, settings: RenderSettings) -> dict[str, Any]:
        """Values by uniform name, or functions that give those that few programs ask for and that take long.

        Lengths are in voxels, except in NDC packs, where the camera is in training units.
        """
        pack = self.pack
        box_min, box_max = self.box(settings)
        near, ray_near = max(camera.near, settings.near), camera.ray_near
        if camera.is_panorama:  # which has no one axis
            near, ray_near = 0.0, max(near, ray_near)
        voxels = 1.0 if pack.ndc else 1.0 / pack.voxel_size
        position = (camera.position - pack.min_xyz) / pack.voxel_size
        scale = pack.voxel_size if camera.orthographic else 1.0  # to pixels per voxel
        training_T_camera = self.training_T_grid @ camera.grid_T_camera
        return {
            "picture_size": (camera.width, camera.height),
            "intrinsics": (camera.fx * scale, camera.fy * scale, camera.cx, camera.cy),
            "orthographic": float(camera.orthographic),
            "lens": lambda: np.reshape(whole_lens(camera.distortion)[:LENS_SIZE], (3, 4)).T,  # a column for each vec4
            "lens_reach": lambda: whole_lens(camera.distortion)[REACH],
            "grid_R_camera": camera.grid_T_camera[:3, :3],
            "camera_position": position,
            "near_plane": near * voxels,
            "ray_near": ray_near * voxels,
            "eye_offset": camera.eye_offset * voxels,
            "box_min": box_min,
            "box_max": box_max,
            "atlas_min": self._inner[0],
            "atlas_max": self._inner[1],
            "training_R_camera": training_T_camera[:3, :3],
            "training_camera": training_T_camera[:3, 3],
            "depth_range": lambda: self.depth_range(camera),
            **self.ndc,
            **self.contraction,
        }

    def box(self, settings: RenderSettings) -> tuple[np.ndarray, np.ndarray]:
        """The grid's box in voxels, cut down to the crop box, and to the inner cube if surroundings are not to be shown; both
        corners at its middle where nothing is left.
        """
        low, high = self._whole if settings.surroundings else self._inner
        if settings.crop is None:
            return low, high
        corners = (np.asarray(settings.crop, np.float64) - self.pack.min_xyz) / self.pack.voxel_size
        low, high = np.maximum(low, corners.min(axis=0)), np.minimum(high, corners.max(axis=0))
        if np.any(high <= low):
            low = high = 0.5 * (low + high)
        return low, high

    def depth_range(self, camera: ViewCamera) -> tuple[float, float]:
        """Distances along its rays, in voxels, between which the grid (its inner cube) lies as seen by `camera`."""
        low, high = self._inner
        size = high - low
        if self.pack.ndc:
            return 0.0, float(np.linalg.norm(size))
        away = 0.5 * (low + high) - (camera.position - self.pack.min_xyz) / self.pack.voxel_size
        middle, radius = float(np.linalg.norm(away)), float(0.5 * np.linalg.norm(size))
        if camera.orthographic:
            middle = float(away @ -camera.grid_T_camera[:3, 2])
            return max(middle - radius, 0.0), max(middle + radius, 1.0)
        return max(middle - radius, 0.0), middle + radius
