"""Lenses that are fitted to a reconstruction, on synthetic ones of pycolmap."""

from __future__ import annotations

import pytest

pycolmap = pytest.importorskip("pycolmap", reason="finding poses needs pycolmap")

from training.posing.mapping import _median_error, _with_two_focals  # noqa: E402


def reconstruction(focals: tuple[float, float]):
    """30 pictures of one camera with these focal lengths, read as one with a single one."""
    pycolmap.set_random_seed(0)
    made = pycolmap.synthesize_dataset(
        pycolmap.SyntheticDatasetOptions(
            num_rigs=1, num_frames_per_rig=30, num_points3D=300, camera_model_id=pycolmap.CameraModelId.OPENCV,
            camera_width=512, camera_height=512, camera_params=[*focals, 256, 256, 0.0, 0.0, 0.0, 0.0],
        )
    )  # fmt: skip
    for camera in made.cameras.values():
        camera.model = pycolmap.CameraModelId.SIMPLE_RADIAL
        camera.params = [sum(focals) / 2, 256.0, 256.0, 0.0]
    return made


def test_squeezed_pictures_get_two_focal_lengths() -> None:
    fitted = _with_two_focals(reconstruction((420.0, 560.0)))
    assert fitted is not None
    (camera,) = fitted.cameras.values()
    assert camera.focal_length_y / camera.focal_length_x == pytest.approx(560 / 420, rel=0.01)


def test_square_pixels_keep_one_focal_length() -> None:
    assert _with_two_focals(reconstruction((500.0, 500.0))) is None


def test_a_diverged_point_does_not_change_the_median_error() -> None:
    made = reconstruction((500.0, 500.0))
    before = _median_error(made)
    next(iter(made.points3D.values())).xyz = (1e30, 0.0, 0.0)
    assert _median_error(made) == pytest.approx(before, abs=0.01)
    assert made.compute_mean_reprojection_error() > 10 * before + 1
