"""All training rays of a scene, kept on the devices as cameras and 8 bit pixels; rays are made from ray ids inside jit.

Notation: V views, P pixels in all (views need not share one size), C = 3 or 4 channels (4 where some pixel is not
opaque: RGB not premultiplied); N rays of a batch. A ray's id in [0, P) counts views, then rows, then columns; (x, y)
are pixel coordinates, centres at +0.5. Where a scene has more pixels than int32 counts, only one row in `row_step` of each
photograph is taken, as if it had no others. Geometry and lens model: training.scenes.scene, whose JAX twin this is.

RayDataset is a pytree: pass it to a jitted function as an argument, so that its pictures are no constants of the
program. Pixels are stored along the mesh (training.devices): a process decodes only the photographs of its devices.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding

from console import UserError
from training.devices import AXIS, WHOLE, anywhere, every_device, here, own_rows, put_split, put_whole, together
from training.method import Rays
from training.scenes import Camera, Scene, load_pixels
from training.scenes.files import notice
from training.scenes.lens import PROJECTION, lens_functions, whole_lens
from training.scenes.pixels import may_be_transparent, pixel_counts, without_alpha
from training.scenes.scene import Kind, camera_rays, ndc_rays, shown_pixels

NEWTON_STEPS = 6  # float32 converges sooner than the reader's float64
LENS = lens_functions(jnp)
MOST_RAYS = 2**31 - 1  # ids are int32
GOLDEN_RATIO = 0x9E3779B97F4A7C15  # less 1, times 2^64
OPAQUE = (
    "the pictures have no alpha; what is behind the object counts as part of the scene and is trained and baked with it"
)


class SceneFacts(NamedTuple):
    """What is known of the space, hashable: a static part of every jitted function."""

    near: float  # bounds of t
    far: float
    aabb: tuple[tuple[float, ...], ...]  # ((x, y, z), (x, y, z)), training frame (NDC space where ndc)
    ndc_camera: tuple[int, int, float] | None  # (width, height, focal)
    disparity: bool  # spread samples in 1/t
    background: tuple[float, float, float]  # sRGB
    distorted: bool  # some lens is not a pinhole
    cut_out: bool = False  # photographs of an object were cut out of what surrounded it, by masks
    row_step: int = 1  # one row in so many is rows of pixels
    rendered: bool = False  # by a program, not by a camera that meters
    contraction: float | None = None  # beyond this on any axis, space is contracted (scenepack.contraction)


@partial(
    jax.tree_util.register_dataclass,
    data_fields=("pixels", "world_T_camera", "intrinsics", "distortion", "first", "width", "gains"),
    meta_fields=("facts", "count", "mesh"),
)
@dataclass(frozen=True)
class RayDataset:
    """The rays of V views; see above."""

    pixels: jax.Array  # uint8 [P (padded to a multiple of D), C], stored along the mesh
    world_T_camera: jax.Array  # [V, 3, 4]
    intrinsics: jax.Array  # [V, 4] = fx, fy, cx, cy
    distortion: jax.Array  # [V, LENS_SIZE + 1]: whole_lens of training.scenes.lens
    first: jax.Array  # int32 [V]: the id of a view's first ray
    width: jax.Array  # int32 [V]
    facts: SceneFacts = field(repr=False)
    count: int  # P, all rays
    mesh: Mesh = field(repr=False)
    gains: jax.Array | None = None  # [V, 3]: what the colours of each view are divided by (training.exposure)

    @property
    def aabb(self) -> np.ndarray:
        """Box that holds the content, float32 [2, 3], in the frame of the rays; all of space where that is contracted."""
        inner = self.facts.contraction
        return np.array(self.facts.aabb if inner is None else [[-2 * inner] * 3, [2 * inner] * 3], np.float32)

    @property
    def background(self) -> tuple[float, float, float]:
        return self.facts.background

    @property
    def ndc(self) -> bool:
        return self.facts.ndc_camera is not None

    @property
    def kind(self) -> Kind:
        """What was photographed, as far as it matters to how a field is trained."""
        if self.ndc:
            return "forward"
        if self.pixels.shape[-1] == 4:
            return "object"
        return "surroundings" if self.facts.contraction is None else "unbounded"

    @property
    def views(self) -> int:
        return self.width.shape[0]

    def local(self) -> RayDataset:
        """The same on one device of this process, for work outside of the step. With many devices it has no pixels."""
        if self.mesh.size == 1:
            return self
        without = replace(self, pixels=jnp.zeros((0, self.pixels.shape[1]), jnp.uint8))
        return replace(here(without), mesh=Mesh(np.array(jax.local_devices()[:1]), (AXIS,)))

    def in_average_look(self, gains: np.ndarray | jax.Array | None) -> RayDataset:
        """The same with colours divided by the gains [V, 3] of their photographs; None: as they are."""
        return replace(self, gains=None if gains is None else put_whole(jnp.asarray(gains), self.mesh))

    def geometry_at(self, ids: jax.Array, away: jax.Array | None = None) -> Rays:
        """Rays of int32 ids [N] in [0, count), through places `away` [N, 2] pixels from their centres; jittable."""
        view = self.view_of(ids)
        rest = ids - self.first[view]
        x, y = rest % self.width[view], rest // self.width[view] * self.facts.row_step
        if away is not None:
            x, y = x + away[:, 0], y + away[:, 1]
        fx, fy, cx, cy = jnp.moveaxis(self.intrinsics[view], -1, 0)
        a, b = (x + 0.5 - cx) / fx, (y + 0.5 - cy) / fy
        in_camera, shown = jnp.stack([a, -b, -jnp.ones_like(a)], axis=-1), jnp.ones_like(a, bool)
        if self.facts.distorted:
            lens = jnp.moveaxis(self.distortion[view], -1, 0)
            a, b, shown = LENS.undistort(a, b, lens, NEWTON_STEPS)
            in_camera = jnp.stack(LENS.direction(a, b, lens[PROJECTION]), axis=-1)
        pose = self.world_T_camera[view]
        directions = jnp.einsum("nij,nj->ni", pose[:, :, :3], in_camera, precision=jax.lax.Precision.HIGHEST)
        directions /= jnp.linalg.norm(directions, axis=-1, keepdims=True)
        origins, viewdirs = pose[:, :, 3], directions
        if self.facts.ndc_camera is not None:
            origins, directions = ndc_rays(origins, directions, *self.facts.ndc_camera, xp=jnp)
        near, far = (jnp.full(origins.shape[:-1], t, jnp.float32) for t in (self.facts.near, self.facts.far))
        return Rays(origins, directions, viewdirs, jnp.where(shown, near, far), far)

    def view_of(self, ids: jax.Array) -> jax.Array:
        """The photographs int32 [N] that rays int32 [N] belong to; jittable."""
        return jnp.searchsorted(self.first, ids, side="right", method="scan_unrolled") - 1

    def colours_at(self, ids: jax.Array, background: jax.Array | None = None) -> jax.Array:
        """Colours float32 [N, 3] of rays over the background, or another [N, 3]; jittable."""
        # the compiler has each device look among its own pixels, and adds up what they find
        pixel = self.pixels[ids].astype(jnp.float32) / 255.0
        colour = pixel[:, :3]
        if self.gains is not None:  # what is clipped in the photograph stays white: how bright it was, nobody knows
            colour = jnp.where(colour < 1.0, jnp.minimum(colour / self.gains[self.view_of(ids)], 1.0), 1.0)
        if pixel.shape[-1] == 3:
            return colour
        behind = jnp.asarray(self.background, jnp.float32) if background is None else background
        return colour * pixel[:, 3:] + (1.0 - pixel[:, 3:]) * behind

    def pixels_here(self, ids: np.ndarray) -> np.ndarray:
        """Pixels uint8 [N, C] of int32 ids [N], the same in every process, from wherever they are."""
        fetch = jax.jit(operator.getitem, out_shardings=NamedSharding(self.mesh, WHOLE))
        return np.asarray(here(fetch(self.pixels, ids)))

    def view_rays(self, camera: Camera) -> Rays:
        """Rays [H W] of every pixel of any camera, row by row, for evaluation (float64 geometry on the host)."""
        origins, directions = (v.reshape(-1, 3) for v in camera_rays(camera))
        viewdirs = directions
        if self.facts.ndc_camera is not None:
            origins, directions = ndc_rays(origins, directions, *self.facts.ndc_camera)
        near, far = (np.full(len(origins), t, np.float32) for t in (self.facts.near, self.facts.far))
        bounds = np.where(shown_pixels(camera).ravel(), near, far), far
        return Rays(*(jnp.asarray(v, jnp.float32) for v in (origins, directions, viewdirs)), *map(jnp.asarray, bounds))


def evenly_spread(first: int, size: int, count: int) -> np.ndarray:
    """int32 [size]: from the `first`-th on, numbers below `count` of a low-discrepancy sequence: multiples of the golden ratio,
    modulo 1, times `count`. Any that follow one another lie evenly spread, and none comes again soon."""
    turns = np.arange(first, first + size, dtype=np.uint64) * np.uint64(GOLDEN_RATIO)
    return ((turns >> np.uint64(32)) * np.uint64(count) >> np.uint64(32)).astype(np.int32)


def row_step_for(scene: Scene) -> int:
    """One row in how many becomes rays; a notice where it is not each."""
    cameras = [photograph.camera for photograph in scene.splits["train"]]
    count, steps = int(pixel_counts(cameras).sum()), range(1, max(camera.height for camera in cameras) + 1)
    step = next((step for step in steps if pixel_counts(cameras, step).sum() <= MOST_RAYS), None)
    if step is None:
        raise UserError("too many pixels", where=scene.path, expected=f"at most {MOST_RAYS:,}", found=f"{count:,}",
                        remedy="use --downscale")  # fmt: skip
    if step > 1:
        problem = f"{count:,} pixels are more than the {MOST_RAYS:,} rays that training can count"
        shrink = math.ceil(math.sqrt(count / MOST_RAYS)) * int(str(scene.notes.get("downscale", 1)))
        remedy = f"it takes one row in {step} of each photograph (or use --downscale {shrink})"
        notice(scene.path, f"{problem}; {remedy}")
    return step


def make_dataset(scene: Scene, *, folder: Path | None = None, contracted: bool = False) -> RayDataset:
    """Decodes the photographs to train on and puts them on the devices of all processes.

    folder: where pixels lie that take too much memory (see load_pixels). contracted: whether to contract space where the scene
    says that it may be. UserError where a picture is bad, in every process.
    """
    mesh, photographs = every_device(), scene.splits["train"]
    cameras = [photograph.camera for photograph in photographs]
    row_step = row_step_for(scene)
    sizes = pixel_counts(cameras, row_step)
    count = int(sizes.sum())
    low, high = own_rows(count, mesh)
    with together():
        channels = 4 if may_be_transparent(photographs) else 3
        own = load_pixels(photographs, low, high, channels=channels, row_step=row_step, folder=folder)
    alpha = own[: max(count - low, 0), 3:]  # without the padding
    if channels == 4 and not anywhere(bool(alpha.min(initial=255) < 255)):
        own, channels = without_alpha(own), 3
    elif channels == 4 and not anywhere(bool(alpha.any())):
        why = "all masks hide everything" if scene.notes.get("masks") else "every pixel is transparent"
        raise UserError(f"there is nothing to see: {why}", where=scene.path, found=f"{len(cameras)} photographs",
                        remedy="check the photographs' alpha, or their masks")  # fmt: skip
    if channels == 3 and scene.kind == "blender":
        notice(scene.path, OPAQUE)
    arrays = {
        "world_T_camera": np.stack([c.world_T_camera[:3] for c in cameras]).astype(np.float32),
        "intrinsics": np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras], np.float32),
        "distortion": np.array([whole_lens(c.distortion) for c in cameras], np.float32),
        "first": (np.cumsum(sizes) - sizes).astype(np.int32),
        "width": np.array([c.width for c in cameras], np.int32),
    }
    facts = SceneFacts(
        near=float(scene.near), far=float(scene.far), aabb=tuple(map(tuple, scene.aabb.tolist())),
        ndc_camera=scene.ndc_camera, disparity=scene.disparity, background=scene.background,
        distorted=any(any(camera.distortion) for camera in cameras),
        cut_out=bool(scene.notes.get("masks")), row_step=row_step, rendered=scene.kind == "blender",
        contraction=scene.contraction if contracted and channels == 3 else None,
    )  # fmt: skip
    pixels = put_split(own, count, mesh)
    return RayDataset(pixels=pixels, **put_whole(arrays, mesh), facts=facts, count=count, mesh=mesh)
