"""What is shown before an export is what is written, in coarser voxels where the grid is fine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from console import UserError
from scenepack import Pack
from scenepack.exports import scene
from scenepack.exports.scene import KINDS, Export, coarseness, export_scene, preview_geometry
from tests.scenepack.exports.test_exports import CENTRE, RADIUS, VOXEL, ball_inside, pack_of

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: the extra dev")


@pytest.fixture(scope="module")
def ball() -> Pack:
    return pack_of(ball_inside())


@pytest.mark.parametrize("kind", KINDS)
def test_a_preview_of_the_same_voxels_is_what_is_written(ball: Pack, tmp_path: Path, kind) -> None:
    export = Export(kind, faces=2000)
    drawn, file = preview_geometry(ball, export), tmp_path / "it.ply"
    written = export_scene(ball, file, export)
    assert (len(drawn.vertices), len(drawn.faces), drawn.coarser) == (written.points, written.faces, 1)
    opened = trimesh.load(file, process=False)
    assert np.allclose(opened.vertices, drawn.vertices, atol=1e-6)
    if kind != "gaussians":
        assert np.array_equal(
            np.asarray(opened.visual.vertex_colors if kind == "mesh" else opened.colors)[:, :3], drawn.colours
        )


@pytest.mark.parametrize("kind", KINDS)
def test_coarser_voxels_make_fewer_of_it_in_the_same_place(ball: Pack, kind, monkeypatch: pytest.MonkeyPatch) -> None:
    fine = preview_geometry(ball, Export(kind, faces=None))
    monkeypatch.setattr(scene, "MOST_CELLS", 21)
    coarse = preview_geometry(ball, Export(kind, faces=None))
    assert coarse.coarser == coarseness(ball) == 2 and len(coarse.vertices) < 0.5 * len(fine.vertices)
    away = np.linalg.norm(coarse.vertices - CENTRE, axis=1)
    if kind != "gaussians":
        assert np.abs(away - RADIUS).max() < 2 * VOXEL
        outward = (coarse.normals * (coarse.vertices - CENTRE)).sum(axis=1)
        assert (outward > 0).mean() > 0.99
    assert away.max() < RADIUS + 2 * VOXEL


def test_nothing_is_told_and_whoever_is_told_may_stop_it(ball: Pack) -> None:
    with pytest.raises(UserError, match="nothing to export"):
        preview_geometry(ball, Export("mesh", crop=((0.9, 0.9, 0.9), (1.0, 1.0, 1.0))))

    def stop(share: float, note: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        preview_geometry(ball, replace(Export("mesh"), level=0.5), stop)
