"""From cameras to pictures: one primary ray per sub-pixel, averaged as premultiplied display colour.

Notation: S sub-pixels a side; a picture is [H, W, 4], RGB not premultiplied, 8 bit. Averaging happens in
display-referred colour because NeRF composites there: edge pixels then agree with the compositing that a
trainer does.
"""

from collections.abc import Sequence

import numpy as np

from tools.procedural.shading import Thing, coverage, display, shade
from tools.procedural.shapes import INFINITY, dot
from training.scenes.scene import Camera, camera_rays, shown_pixels

LAYERS = 12  # of glass, and one of what is not, that a ray may go through
CHUNK = 1 << 15  # rays at a time, so that temporaries stay in the cache


def primary_rays(camera: Camera, subpixels: int) -> tuple[np.ndarray, np.ndarray]:
    """o, d [H W S S, 3] of a camera, sub-pixels of a pixel next to each other."""
    offsets = (np.arange(subpixels) + 0.5) / subpixels
    y, x, sy, sx = np.meshgrid(np.arange(camera.height), np.arange(camera.width), offsets, offsets, indexing="ij")
    o, d = camera_rays(camera, (x + sx).ravel(), (y + sy).ravel())
    return o.astype(np.float32), d.astype(np.float32)


def nearest(
    things: Sequence[Thing], o: np.ndarray, d: np.ndarray, leaving: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """t [N] and the number of the thing hit [N] (-1: none). leaving [N]: the thing that a ray comes out of, which it does not
    hit again (-1: none). Each thing is asked only of rays through its bounding ball.
    """
    t = np.full(len(o), INFINITY, np.float32)
    which = np.full(len(o), -1, np.int32)
    for index, thing in enumerate(things):
        centre, radius = thing.shape.bound
        to = centre - o
        along = dot(d, to)
        passes = (dot(to, to) - along * along) < np.float32(radius * radius) * 1.01
        through = np.flatnonzero(passes & (leaving != index))
        if not len(through):
            continue
        hit = thing.shape.hit(o[through], d[through])
        closer = hit < t[through]
        t[through[closer]] = hit[closer]
        which[through[closer]] = index
    return t, which


def trace(things: Sequence[Thing], o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Premultiplied display colour and coverage [N, 4] of rays: what is hit first over what is behind it, where that is glass."""
    result = np.zeros((len(o), 4), np.float32)
    passed = np.ones(len(o), np.float32)
    rays, leaving = np.arange(len(o)), np.full(len(o), -1, np.int32)
    for _ in range(LAYERS):
        t, which = nearest(things, o, d, leaving)
        hit = which >= 0
        rays, o, d, t, which = rays[hit], o[hit], d[hit], t[hit], which[hit]
        p, hides = o + t[:, None] * d, np.ones(len(rays), np.float32)
        for index in np.unique(which):
            at = np.flatnonzero(which == index)
            n = things[index].shape.normal(p[at])
            n = np.where(dot(n, d[at])[:, None] > 0, -n, n)
            if things[index].material.opacity < 1:
                hides[at] = coverage(things[index].material, n, -d[at])
            shown = np.clip(display(shade(things, int(index), p[at], n, -d[at])), 0, 1)
            result[rays[at], :3] += (passed[rays[at]] * hides[at])[:, None] * shown
        passed[rays] *= 1 - hides
        through = hides < 1
        rays, o, d, leaving = rays[through], p[through], d[through], which[through]
        if not len(rays):
            break
    result[:, 3] = 1 - passed
    return result


def picture(things: Sequence[Thing], camera: Camera, subpixels: int = 3) -> np.ndarray:
    """Renders uint8 [H, W, 4] with a transparent background and RGB not premultiplied."""
    o, d = primary_rays(camera, subpixels)
    colours = np.concatenate([trace(things, o[i : i + CHUNK], d[i : i + CHUNK]) for i in range(0, len(d), CHUNK)])
    mean = colours.reshape(camera.height, camera.width, subpixels**2, 4).mean(2) * shown_pixels(camera)[..., None]
    straight = mean[..., :3] / np.maximum(mean[..., 3:], 1e-6)
    return np.rint(np.concatenate([straight, mean[..., 3:]], -1) * 255).astype(np.uint8)
