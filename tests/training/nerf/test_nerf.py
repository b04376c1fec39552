"""The paper's field and method: its structure, that it learns, and where along a ray it is asked."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from training.checkpoints import named_leaves
from training.config import PRESETS, TINY, NerfConfig
from training.dataset import RayDataset, SceneFacts
from training.method import Rays
from training.nerf import model
from training.nerf.method import NerfMethod
from training.nerf.model import draw_perturbation, init_nerf, render_rays
from training.scenes import Scene
from training.scenes.presets import PresetName


def random_batch(dataset: RayDataset, count: int) -> tuple[Rays, jax.Array]:
    ids = jax.random.randint(jax.random.key(1), (count,), 0, dataset.count)
    return dataset.geometry_at(ids), dataset.colours_at(ids)


# Layers by hand: the encoding has 63 channels, 27 for directions; the sixth layer gets the encoding again.
TRUNK_512 = (63 * 512 + 512) + 4 * (512 * 512 + 512) + (575 * 512 + 512) + 2 * (512 * 512 + 512)
TRUNK_256 = (63 * 256 + 256) + 4 * (256 * 256 + 256) + (319 * 256 + 256) + 2 * (256 * 256 + 256)
VIEW_MLP = (34 * 16 + 16) + (16 * 16 + 16) + (16 * 3 + 3)


def nerf_head(width: int) -> int:
    return (width * width + width) + ((width + 27) * 128 + 128) + (128 * 3 + 3)


@pytest.mark.parametrize(
    ("preset", "of_one_model"),
    [
        *((preset, TRUNK_512 + 512 * 8 + 8 + VIEW_MLP) for preset in ("paper", "deferred", "no-sparsity", "tinyview")),
        ("diffuse", TRUNK_512 + 512 * 4 + 4),
        ("jaxnerf-plus", TRUNK_512 + 512 * 1 + 1 + nerf_head(512)),
        ("jaxnerf", TRUNK_256 + 256 * 1 + 1 + nerf_head(256)),
    ],
)
def test_presets_of_the_papers_tables_have_the_parameters_counted_by_hand(preset: PresetName, of_one_model: int):
    both_models = jax.eval_shape(lambda key: init_nerf(key, PRESETS[preset].nerf), jax.random.key(0))
    assert sum(leaf.size for leaf in jax.tree.leaves(both_models)) == 2 * of_one_model


@pytest.mark.slow
@pytest.mark.usefixtures("hardly_optimised")
@pytest.mark.parametrize("view", ["deferred", "tiny", "nerf", "none"])
def test_every_preset_learns_and_gradients_reach_every_parameter(scene: Scene, dataset: RayDataset, view):
    sizes = {"depth": 3, "skip_after": 1, "coarse_samples": 8, "fine_samples": 8}
    nerf = dataclasses.replace(TINY.nerf, view=view, **sizes, warmup_steps=0, clip_norm=0)
    method = NerfMethod(dataclasses.replace(TINY, batch_size=128, steps=40, nerf=nerf), dataset)
    state = method.start(jax.random.key(0))
    rays, target = random_batch(dataset, 128)
    gradient, _ = jax.jit(method._gradient)(state.params, rays, target, draw_perturbation(jax.random.key(2), 128, nerf))
    for name, leaf in named_leaves(gradient).items():
        assert np.abs(np.asarray(leaf)).max() > 0, f"no gradient reaches {name}"
    losses = []
    for step in range(40):
        state, metrics = method.step(state, step)
        losses.append(float(metrics["loss"]))
    update: Any = method._update
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:5]) and update._cache_size() == 1
    picture = method.render(state, dataset.view_rays(scene.splits["test"][0].camera))
    assert np.isfinite(np.asarray(picture.rgb)).all() and picture.alpha.shape == picture.rgb.shape[:1]
    assert (method.view_mlp(state) is not None) == (view == "deferred")


@pytest.mark.slow
def test_slices_of_a_batch_give_the_gradient_of_the_whole(dataset: RayDataset, monkeypatch):
    def linear_fit(self, params, rays, target, noise):  # smooth, as fine sampling is not
        loss = jnp.mean(jnp.square(rays.directions @ params + noise - target))
        return loss, {"loss": loss}

    monkeypatch.setattr(NerfMethod, "_loss", linear_fit)
    rays, target = random_batch(dataset, 32)
    whole = dataclasses.replace(TINY, batch_size=32)
    sliced = dataclasses.replace(whole, nerf=dataclasses.replace(TINY.nerf, gradient_rays=8))
    params: Any = jax.random.normal(jax.random.key(2), (3, 3))
    noise: Any = jax.random.uniform(jax.random.key(3), (32, 1))
    expected, metrics = NerfMethod(whole, dataset)._gradient(params, rays, target, noise)
    gradient, means = NerfMethod(sliced, dataset)._gradient(params, rays, target, noise)
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    assert float(means["loss"]) == pytest.approx(float(metrics["loss"]), rel=1e-5)


@pytest.mark.slow
def test_the_sparsity_loss_sees_densities_without_the_noise(dataset: RayDataset):
    nerf = dataclasses.replace(TINY.nerf, density_noise=5.0, coarse_samples=8, fine_samples=8)
    rays, _ = random_batch(dataset, 16)
    perturbation = draw_perturbation(jax.random.key(2), 16, nerf)
    params = init_nerf(jax.random.key(0), nerf)
    noisy = render_rays(params, rays, nerf, dataset.facts, perturbation)
    silent = render_rays(params, rays, nerf, dataset.facts, perturbation._replace(coarse_noise=None, fine_noise=None))
    np.testing.assert_allclose(noisy.coarse_sigma, silent.coarse_sigma, rtol=1e-5)
    assert np.abs(noisy.coarse.alpha - silent.coarse.alpha).max() > 0.01, "the picture has it"


@pytest.mark.parametrize("ndc, given, expected", [(True, None, [0.25, 0.0]), (False, None, 1e10), (True, 0.5, 0.5)])
def test_the_last_sample_stands_for_the_rest_up_to_the_far_plane_in_ndc_and_for_all_elsewhere(ndc, given, expected):
    camera = (40, 32, 50.0) if ndc else None
    facts = SceneFacts(0.0, 1.0, ((-1.0,) * 3, (1.0,) * 3), camera, False, (1.0, 1.0, 1.0), False)
    rays = Rays(*(jnp.ones((2, 3)),) * 3, near=jnp.zeros(2), far=jnp.ones(2))
    t = jnp.asarray([[0.1, 0.75], [0.2, 1.0]])
    last = model.last_interval(t, rays, NerfConfig(last_interval=given), facts)
    np.testing.assert_allclose(np.asarray(last).ravel(), np.ravel(expected), atol=1e-6)


def test_fine_samples_crowd_where_the_coarse_weights_are():
    t = model.coarse_samples(None, jnp.full(5, 2.0), jnp.full(5, 6.0), 41)
    weights = jnp.exp(-0.5 * ((t - 4.5) / 0.05) ** 2)
    fine = np.asarray(model.fine_samples(jax.random.uniform(jax.random.key(1), (5, 64)), t, weights, 64))
    assert (np.diff(fine) >= 0).all()
    assert (np.abs(fine - 4.5) < 0.3).mean() > 0.95
