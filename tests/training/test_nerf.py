"""The paper's field and method: its structure, and that it learns."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from console import UserError
from training.config import PAPER, PRESETS, SMALL, TINY, NerfConfig
from training.dataset import make_dataset
from training.metrics import psnr
from training.nerf.field import apply_field, init_field
from training.nerf.method import NerfMethod, batch_slices, in_slices
from training.nerf.render import init_nerf
from training.scenes import Scene
from training.validation import render_photograph


def size_of(tree) -> int:
    return sum(leaf.size for leaf in jax.tree.leaves(jax.eval_shape(lambda: tree) if callable(tree) else tree))


def test_the_papers_field_has_1_907_720_parameters():
    field = jax.eval_shape(lambda key: init_field(key, PAPER.nerf), jax.random.key(0))
    first, skip, hidden = 63 * 512 + 512, (512 + 63) * 512 + 512, 512 * 512 + 512
    # layers 1-4, then the one that gets the encoding again, then 6 and 7; 8 outputs
    assert size_of(field) == first + 4 * hidden + skip + 2 * hidden + 512 * 8 + 8 == 1_907_720
    assert field.trunk[5].weight.shape == (575, 512)


def test_both_models_have_a_field_and_a_view_mlp_of_their_own():
    params = jax.eval_shape(lambda key: init_nerf(key, PAPER.nerf), jax.random.key(0))
    assert size_of(params) == 2 * (1_907_720 + 883)
    diffuse = dataclasses.replace(PAPER.nerf, view_dependence=False)
    assert size_of(jax.eval_shape(lambda key: init_nerf(key, diffuse), jax.random.key(0))) == 2 * 1_907_720


def test_the_small_field_is_the_same_at_256_channels():
    field = jax.eval_shape(lambda key: init_field(key, SMALL.nerf), jax.random.key(0))
    assert [layer.weight.shape for layer in field.trunk] == [
        (63, 256),
        (256, 256),
        (256, 256),
        (256, 256),
        (256, 256),
        (319, 256),
        (256, 256),
        (256, 256),
    ]


def test_density_is_never_negative_and_colours_and_features_stay_in_the_unit_range():
    config = NerfConfig(depth=2, width=16, skip_after=0)
    out = apply_field(init_field(jax.random.key(0), config), 5 * jax.random.normal(jax.random.key(1), (500, 3)), 0)
    assert out.density.shape == (500,) and out.diffuse.shape == (500, 3) and out.features.shape == (500, 4)
    assert (np.asarray(out.density) >= 0).all() and (np.asarray(out.density) > 0).any()
    for values in (out.diffuse, out.features):
        assert float(values.min()) >= 0 and float(values.max()) <= 1


def test_slices_of_a_batch_give_the_gradient_of_the_whole(procedural_scene: Scene, monkeypatch):
    def linear_fit(self, params, rays, target, key):
        loss = jnp.mean(jnp.square(rays.directions @ params - target))
        return loss, {"loss": loss}

    monkeypatch.setattr(NerfMethod, "_loss", linear_fit)
    dataset = make_dataset(procedural_scene)
    rays, target = dataset.batch(jax.random.key(1), 32)
    whole = dataclasses.replace(TINY, batch_size=32)
    sliced = dataclasses.replace(whole, nerf=dataclasses.replace(TINY.nerf, gradient_rays=8))
    params, key = jax.random.normal(jax.random.key(2), (3, 3)), jax.random.key(3)
    expected, metrics = NerfMethod(whole, dataset)._gradient(params, rays, target, key)
    gradient, means = NerfMethod(sliced, dataset)._gradient(params, rays, target, key)
    np.testing.assert_allclose(gradient, expected, atol=1e-6)
    assert float(means["loss"]) == pytest.approx(float(metrics["loss"]), rel=1e-5)


def test_a_batch_that_cannot_be_cut_evenly_is_refused():
    assert batch_slices(8192, 1024) == 8 and batch_slices(8192, 0) == 1 and batch_slices(100, 200) == 1
    with pytest.raises(UserError, match="evenly"):
        batch_slices(1000, 300)


@pytest.mark.parametrize("count", [1, 7, 8, 20])
def test_any_number_of_rows_goes_through_slices_of_one_size(count: int):
    sizes = []

    def double(x):
        sizes.append(x.shape)
        return 2 * x

    x = jnp.arange(count * 2.0).reshape(count, 2)
    np.testing.assert_array_equal(in_slices(double, x, 8), 2 * x)
    assert set(sizes) == {(8, 2)}


def test_the_tiny_preset_learns_the_scene_without_recompiling(procedural_scene: Scene):
    dataset = make_dataset(procedural_scene)
    method = NerfMethod(TINY, dataset)
    state = method.start(jax.random.key(0))
    for step in range(TINY.steps):
        state, metrics = method.step(state, step)
    assert method._update._cache_size() == 1
    assert set(metrics) >= {"loss", "psnr", "sparsity", "learning_rate"}

    gains = []
    for photograph in procedural_scene.splits["test"]:
        rendered, truth = render_photograph(method, state, dataset, photograph)
        gains.append(psnr(rendered, truth) - psnr(np.broadcast_to(truth.mean((0, 1)), truth.shape), truth))
    assert np.mean(gains) > 4.0, gains  # dB over the best single colour, on views it never saw

    field = method.query(state, jnp.asarray([[0.0, 0.0, 1.45], [0.3, -0.3, -0.76]]))
    assert field.density.shape == (2,) and field.features.shape == (2, 4)
    assert float(field.density[1]) > 10 * float(field.density[0])  # the turntable against the air above
    view = method.view_mlp(state)
    assert view is not None and view.weights[0].shape == (34, 16)


def test_presets_are_named_as_the_command_names_them():
    from typing import get_args

    from training.commands.train import PresetName

    assert set(get_args(PresetName)) == set(PRESETS)
