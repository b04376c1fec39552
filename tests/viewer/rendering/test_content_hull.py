"""The hull that decides which pixels are shaded: closed, tight enough, and never in the way of content."""

from __future__ import annotations

from collections import Counter

import moderngl
import numpy as np
import pytest

from scenepack import Pack
from tests.viewer.rendering.pictures import assert_same_picture
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.skip_grid import CELL, MARGIN, hull_triangles


def blobs(seed: int) -> np.ndarray:
    """bool [z, y, x]: one cell, a plate one cell thin, or a cloud, by seed."""
    rng = np.random.default_rng(seed)
    content = np.zeros((40, 70, 23), bool)
    if seed == 0:
        content[3, 4, 5] = True
    elif seed == 1:
        content[:, 7, :] = True
    else:
        content[tuple(rng.integers(0, n, 60) for n in content.shape)] = True
    return content


@pytest.mark.parametrize("seed", range(5))
def test_all_content_is_inside_by_the_margin(seed: int) -> None:
    content = blobs(seed)
    triangles = hull_triangles(content).astype(float)
    cells = np.argwhere(content)[:, ::-1]
    ends = np.concatenate([cells, cells + 1]) * CELL - 0.5
    corners = (
        np.stack(np.meshgrid(*zip(ends.min(0), ends.max(0), strict=True)), -1).reshape(-1, 3) if seed < 2 else ends
    )
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outside = ((corners[:, None] - triangles[None, :, 0]) * normals).sum(-1)
    assert outside.max() < -0.5 * MARGIN
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    group = -(-max(content.shape) // 32) * CELL
    assert np.all(low > ends.min(0) - group - 3) and np.all(high < ends.max(0) + group + 3)


@pytest.mark.parametrize("seed", range(5))
def test_every_edge_belongs_to_two_triangles_that_run_along_it_in_opposite_directions(seed: int) -> None:
    triangles = [tuple(map(tuple, triangle)) for triangle in hull_triangles(blobs(seed)).tolist()]
    edges = Counter((t[i], t[(i + 1) % 3]) for t in triangles for i in range(3))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)


def test_a_framebuffer_without_depth_shows_the_same_picture(ctx: moderngl.Context, shapes: Pack) -> None:
    camera = ViewCamera.orbit(shapes, 35, size=(64, 48))
    with OffscreenRenderer(shapes, ctx=ctx) as offscreen:
        expected = offscreen.render(camera)
        texture = ctx.texture((64, 48), 4)
        bare = ctx.framebuffer([texture])
        offscreen.renderer.render(bare, camera)
        pixels = np.frombuffer(bare.read(components=3, alignment=1), np.uint8).reshape(48, 64, 3)[::-1]
        offscreen.framebuffer(64, 48).use()
        assert_same_picture(pixels / 255, expected / 255)
        bare.release()
        texture.release()
