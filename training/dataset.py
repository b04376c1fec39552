"""All training rays of a scene, kept on the device as cameras and 8 bit pixels; rays are made from pixel
indices inside jit.

Notation: V views of H x W pixels with C = 3 or 4 channels (4 where some pixel is not opaque: RGB not
premultiplied); N rays of a batch; (x, y) pixel coordinates, centres at +0.5. Geometry and lens model:
training.scenes.rays, whose JAX twin this is (a test compares them).

RayDataset is a pytree: pass it to a jitted function as an argument, so that its pictures are no constants
of the program.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from training.method import Rays
from training.scenes import Camera, Scene, load_pictures
from training.scenes.rays import NDC_NEAR, camera_rays, ndc_rays

NEWTON_STEPS = 6  # float32 converges sooner than the reader's float64


class SceneFacts(NamedTuple):
    """What is known of the space, hashable: a static part of every jitted function.

    near, far: bounds of t. aabb: ((x, y, z), (x, y, z)), training frame (NDC space where ndc). ndc_camera:
    (width, height, focal) or None. disparity: spread samples in 1/t. background: sRGB. distorted: some
    lens is not a pinhole.
    """

    near: float
    far: float
    aabb: tuple[tuple[float, ...], ...]
    ndc_camera: tuple[int, int, float] | None
    disparity: bool
    background: tuple[float, float, float]
    distorted: bool


@partial(
    jax.tree_util.register_dataclass,
    data_fields=("pixels", "world_T_camera", "intrinsics", "distortion"),
    meta_fields=("facts",),
)
@dataclass(frozen=True)
class RayDataset:
    """pixels uint8 [V, H, W, C]; world_T_camera [V, 3, 4]; intrinsics [V, 4] = fx, fy, cx, cy; distortion [V, 4]."""

    pixels: jax.Array
    world_T_camera: jax.Array
    intrinsics: jax.Array
    distortion: jax.Array
    facts: SceneFacts = field(repr=False)

    @property
    def near(self) -> float:
        """Where rays begin (t)."""
        return self.facts.near

    @property
    def far(self) -> float:
        """Where rays end (t)."""
        return self.facts.far

    @property
    def aabb(self) -> np.ndarray:
        """Box that holds the content, float32 [2, 3], in the frame of the rays."""
        return np.array(self.facts.aabb, np.float32)

    @property
    def background(self) -> tuple[float, float, float]:
        """Colour behind everything."""
        return self.facts.background

    @property
    def ndc(self) -> bool:
        """Whether rays are warped to NDC space."""
        return self.facts.ndc_camera is not None

    @property
    def views(self) -> int:
        """Number of training photographs V."""
        return self.pixels.shape[0]

    @property
    def count(self) -> int:
        """Number of training rays V H W; a ray's id counts views, then rows, then columns."""
        views, height, width, _ = self.pixels.shape
        return views * height * width

    def rays_at(self, ids: jax.Array) -> tuple[Rays, jax.Array]:
        """Rays of int32 ids [N] in [0, count), and their colours [N, 3]; jittable."""
        _, height, width, _ = self.pixels.shape
        view, rest = ids // (height * width), ids % (height * width)
        y, x = rest // width, rest % width
        return self.rays(view, x, y), self.colours(view, x, y)

    def batch(self, key: jax.Array, size: int) -> tuple[Rays, jax.Array]:
        """`size` rays through pixel centres drawn evenly from all views, and their colours [N, 3]; jittable."""
        views, height, width, _ = self.pixels.shape
        view, y, x = (
            jax.random.randint(k, (size,), 0, limit)
            for k, limit in zip(jax.random.split(key, 3), (views, height, width), strict=True)
        )
        return self.rays(view, x, y), self.colours(view, x, y)

    def rays(self, view: jax.Array, x: jax.Array, y: jax.Array) -> Rays:
        """Rays through the centres of pixels: column x [N], row y [N] of photograph `view` [N]; jittable."""
        fx, fy, cx, cy = jnp.moveaxis(self.intrinsics[view], -1, 0)
        a, b = (x + 0.5 - cx) / fx, (y + 0.5 - cy) / fy
        if self.facts.distorted:
            a, b = undistort(a, b, self.distortion[view])
        pose = self.world_T_camera[view]
        directions = jnp.einsum("nij,nj->ni", pose[:, :, :3], jnp.stack([a, -b, -jnp.ones_like(a)], axis=-1))
        directions /= jnp.linalg.norm(directions, axis=-1, keepdims=True)
        return finish_rays(pose[:, :, 3], directions, self.facts)

    def colours(self, view: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
        """Colours float32 [N, 3] of pixels over the background; jittable."""
        pixel = self.pixels[view, y, x].astype(jnp.float32) / 255.0
        if pixel.shape[-1] == 3:
            return pixel
        alpha = pixel[:, 3:]
        return pixel[:, :3] * alpha + (1.0 - alpha) * jnp.asarray(self.background, jnp.float32)

    def view_rays(self, camera: Camera) -> Rays:
        """Rays [H W] of every pixel of any camera, row by row, for evaluation (float64 geometry on the host)."""
        origins, directions = (v.reshape(-1, 3) for v in camera_rays(camera))
        viewdirs = directions
        if self.facts.ndc_camera is not None:
            origins, directions = ndc_rays(origins, directions, *self.facts.ndc_camera)
        bounds = (np.full(len(origins), t, np.float32) for t in (self.near, self.far))
        return Rays(*(jnp.asarray(v, jnp.float32) for v in (origins, directions, viewdirs)), *map(jnp.asarray, bounds))


def finish_rays(origins: jax.Array, directions: jax.Array, facts: SceneFacts) -> Rays:
    """Rays of world-space origins and unit directions [N, 3]: bounds added, warped to NDC where the scene is."""
    viewdirs = directions
    if facts.ndc_camera is not None:
        origins, directions = ndc_warp(origins, directions, *facts.ndc_camera)
    near, far = (jnp.full(origins.shape[:-1], t, jnp.float32) for t in (facts.near, facts.far))
    return Rays(origins, directions, viewdirs, near, far)


def ndc_warp(o: jax.Array, d: jax.Array, width: int, height: int, focal: float) -> tuple[jax.Array, jax.Array]:
    """training.scenes.rays.ndc_rays in JAX: NeRF's appendix C with the near plane at NDC_NEAR."""
    o = o - ((NDC_NEAR + o[..., 2]) / d[..., 2])[..., None] * d
    scale = jnp.array([-2.0 * focal / width, -2.0 * focal / height], o.dtype)
    position, slope = o[..., :2] / o[..., 2:], d[..., :2] / d[..., 2:]
    inverse = 2.0 * NDC_NEAR / o[..., 2:]
    return (
        jnp.concatenate([scale * position, 1.0 + inverse], axis=-1),
        jnp.concatenate([scale * (slope - position), -inverse], axis=-1),
    )


def undistort(u: jax.Array, v: jax.Array, distortion: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Undistorted image coordinates [N] of lens coordinates u, v [N] (y down); distortion [N, 4] = k1, k2, p1, p2."""
    k1, k2, p1, p2 = jnp.moveaxis(distortion, -1, 0)
    a, b = u, v
    for _ in range(NEWTON_STEPS):
        r2 = a * a + b * b
        radial, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * k2 * r2)
        du = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a) - u
        dv = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b - v
        ua = radial + a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a
        ub = a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
        vb = radial + b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a
        determinant = ua * vb - ub * ub
        usable = jnp.abs(determinant) > 1e-6  # where the lens model folds over, stay
        scale = jnp.where(usable, 1.0 / jnp.where(usable, determinant, 1.0), 0.0)
        a, b = a - scale * (vb * du - ub * dv), b - scale * (ua * dv - ub * du)
    return a, b


def make_dataset(scene: Scene, split: str = "train") -> RayDataset:
    """Decodes the photographs of a split and puts them on the device. UserError where a picture is bad."""
    photographs = scene.splits[split]
    pixels = load_pictures(photographs)
    cameras = [photograph.camera for photograph in photographs]
    facts = SceneFacts(
        near=float(scene.near),
        far=float(scene.far),
        aabb=tuple(tuple(float(c) for c in corner) for corner in scene.aabb),
        ndc_camera=scene.ndc_camera,
        disparity=scene.disparity,
        background=tuple(float(c) for c in scene.background),  # type: ignore[arg-type]
        distorted=any(any(camera.distortion) for camera in cameras),
    )
    return RayDataset(
        pixels=jnp.asarray(pixels),
        world_T_camera=jnp.asarray(np.stack([c.world_T_camera[:3] for c in cameras]), jnp.float32),
        intrinsics=jnp.asarray([[c.fx, c.fy, c.cx, c.cy] for c in cameras], jnp.float32),
        distortion=jnp.asarray([c.distortion for c in cameras], jnp.float32),
        facts=facts,
    )
